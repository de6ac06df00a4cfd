from .distribute import Failure as Failure
from .distribute import TaskError as TaskError
from .distribute import agent as agent
from .server import Server as Server
from .server import make_certificates as make_certificates
from .server import start_server as start_server
