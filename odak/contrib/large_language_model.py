"""One question to a language model that runs behind an Ollama server."""

import json
import re
import urllib.request

from odak import _validate

# Longer than any answer: a server that never stops sending must not fill the memory.
_LARGEST_ANSWER = 16 * 2**20


def query_llm(
    prompt: str,
    address: str = "127.0.0.1",
    port: int = 11434,
    model: str = "gemma3:4b",
    endpoint: str = "/api/chat",
    temperature: float = 0.6,
    max_tokens: int = 40,
    timeout: float = 10,
) -> str:
    """Send one prompt to a server of language models and return the answer.

    Parameters
    ----------
    prompt : str
        The question.
    address : str
        Name or number of the server.
    port : int
        Its port.
    model : str
        Name of the model.
    endpoint : str
        Path of the chat service.
    temperature : float
        Randomness of the answer, at least 0.
    max_tokens : int
        Longest answer.
    timeout : float
        Seconds to wait.

    Returns
    -------
    str
        The answer without white space around it.

    Raises
    ------
    TypeError
        If the prompt is not a string.
    ValueError
        If the address or the endpoint cannot be part of a URL, the answer is longer than 16 MiB, is not JSON, or lacks
        ``message.content``.
    urllib.error.URLError
        If the server does not answer.

    Examples
    --------
    >>> from odak.tools import query_llm
    >>> query_llm("What is a hologram?", max_tokens=60)  # doctest: +SKIP
    'A hologram is a recording of the interference of light …'

    Where no server answers, the standard library raises its error:

    >>> import urllib.error
    >>> try:
    ...     query_llm("What is a hologram?", port=1, timeout=1)
    ... except urllib.error.URLError:
    ...     print("no answer")
    no answer
    """
    _validate.instance("prompt", prompt, str, "a string")
    if not re.fullmatch(r"[\w.:\[\]-]+", address, re.ASCII):
        raise ValueError(f"address must be the name or the number of a server, got {address!r}")
    if not re.fullmatch(r"[!-~]+", endpoint):
        raise ValueError(f"endpoint must be a path without spaces and control characters, got {endpoint!r}")
    payload = {
        "model": model,
        "messages": [{"role": "user", "content": prompt}],
        "stream": False,
        "options": {"temperature": temperature, "num_predict": max_tokens},
    }
    url = f"http://{address}:{_validate.integer('port', port, minimum=1)}/{endpoint.lstrip('/')}"
    request = urllib.request.Request(
        url, data=json.dumps(payload).encode(), headers={"Content-Type": "application/json"}, method="POST"
    )
    with urllib.request.urlopen(request, timeout=timeout) as response:
        content = response.read(_LARGEST_ANSWER + 1)
    return _answer(content)


def _answer(content: bytes) -> str:
    if len(content) > _LARGEST_ANSWER:
        raise ValueError(f"The server's answer is longer than {_LARGEST_ANSWER} bytes")
    with _validate.refusing("The server's answer is not JSON: ", ValueError, RecursionError):
        answer = json.loads(content)
    for key in ("message", "content"):
        if not isinstance(answer, dict) or key not in answer:
            raise ValueError(f"The server's answer lacks {key!r}")
        answer = answer[key]
    if not isinstance(answer, str):
        raise ValueError(f"The server's answer must contain a string, got {type(answer).__name__}")
    return answer.strip()
