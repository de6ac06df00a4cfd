from . import commands as commands
from . import large_language_model as large_language_model
from . import texts as texts
