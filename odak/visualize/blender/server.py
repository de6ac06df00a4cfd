"""Commands as texts, carried out by name: a text is taken apart, never run, and nothing listens on a port."""

import ast
import queue
import threading

from odak.log import logger

__all__ = [
    "execute_queued_functions",
    "main",
    "parse_function_call_safely",
    "run_in_main_thread",
    "validate_and_queue_command",
    "whisper2blender",
]

COMMANDS = ("import_ply", "prepare", "delete_the_cube", "render", "cylinder_between", "quit", "delete_object")
LONGEST = 4096
_waiting: queue.Queue = queue.Queue(maxsize=100)


def parse_function_call_safely(cmd_str: str, expected_func_name: str) -> tuple[str | None, list, dict]:
    """Take the text of a call apart.

    Parameters
    ----------
    cmd_str : str
        Such as ``"render('picture.png', exit=True)"``. Arguments must be literals: numbers, strings, lists, tuples,
        dictionaries, True, False, None.
    expected_func_name : str
        The name that must be called.

    Returns
    -------
    tuple
        Name, positional and named arguments; (None, [], {}) for any other text.
    """
    refused: tuple = (None, [], {})
    if not isinstance(cmd_str, str) or len(cmd_str) > LONGEST:
        return refused
    try:
        call = ast.parse(cmd_str.strip(), mode="eval").body
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or call.func.id != expected_func_name:
            return refused
        if any(keyword.arg is None for keyword in call.keywords):
            return refused
        arguments = [ast.literal_eval(argument) for argument in call.args]
        return call.func.id, arguments, {keyword.arg: ast.literal_eval(keyword.value) for keyword in call.keywords}
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return refused


def validate_and_queue_command(cmd_str: str) -> bool:
    """Queue a command if it is one of those known, and its arguments are literals.

    Parameters
    ----------
    cmd_str : str
        Text of the call of import_ply, prepare, delete_the_cube, render, cylinder_between, quit or delete_object.

    Returns
    -------
    bool
        Whether it was queued; the log says why not.
    """
    from odak.visualize.blender import wrapper

    for expected in COMMANDS:
        name, arguments, named = parse_function_call_safely(cmd_str, expected)
        if name is not None:
            return run_in_main_thread((getattr(wrapper, name), arguments, named))
    logger.warning("Blender: refused %.100r; known are calls of %s with literals", cmd_str, ", ".join(COMMANDS))
    return False


def run_in_main_thread(function_tuple) -> bool:
    """Queue a call.

    Parameters
    ----------
    function_tuple : tuple or callable
        Function, positional arguments, named arguments; or a function without arguments.

    Returns
    -------
    bool
        Whether there was room: at most 100 calls wait.
    """
    function, arguments, named = (function_tuple, [], {}) if callable(function_tuple) else function_tuple
    try:
        _waiting.put_nowait((function, arguments, named))
    except queue.Full:
        logger.warning("Blender: %d commands wait already; %s is dropped", _waiting.maxsize, function.__name__)
        return False
    return True


def execute_queued_functions() -> float:
    """Carry out what waits, in order; return 0.1, the seconds after which to call again.

    Raises
    ------
    Exception
        What a command raises; those behind it stay queued.
    """
    while True:
        try:
            function, arguments, named = _waiting.get_nowait()
        except queue.Empty:
            return 0.1
        function(*arguments, **named)


class whisper2blender(threading.Thread):
    """A thread that carries out what waits, once. No port is opened.

    Parameters
    ----------
    port, host, path_max : int, str, int
        Count for nothing.
    """

    def __init__(self, port: int = 8082, host: str = "127.0.0.1", path_max: int = LONGEST):
        super().__init__(daemon=True)
        self.port, self.host, self.path_max = port, host, path_max

    def run(self) -> None:
        """Carry out what waits."""
        execute_queued_functions()


def main() -> None:
    """Carry out what waits."""
    execute_queued_functions()
