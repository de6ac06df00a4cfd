import io
import json

import pytest

from odak.tools import large_language_model, query_llm


@pytest.fixture
def server(monkeypatch):
    """Return a list of the requests that a mocked server gets, and a way to say what it answers."""
    requests, answers = [], [b'{"message": {"content": "  forty-two\\n"}}']

    def urlopen(request, timeout):
        requests.append((request, timeout))
        return io.BytesIO(answers[-1])

    monkeypatch.setattr(large_language_model.urllib.request, "urlopen", urlopen)
    return requests, answers


@pytest.mark.parametrize("endpoint", ["/api/chat", "api/chat"])
def test_request_and_answer(server, endpoint):
    answer = query_llm("How many?", "1.2.3.4", 9999, "m", endpoint, 0.1, 7, timeout=3)
    assert answer == "forty-two"
    request, timeout = server[0][0]
    assert request.full_url == "http://1.2.3.4:9999/api/chat"
    assert request.get_method() == "POST"
    assert request.get_header("Content-type") == "application/json"
    assert timeout == 3
    assert json.loads(request.data) == {
        "model": "m",
        "messages": [{"role": "user", "content": "How many?"}],
        "stream": False,
        "options": {"temperature": 0.1, "num_predict": 7},
    }


@pytest.mark.parametrize(
    "answer, message",
    [
        (b"{}", "lacks 'message'"),
        (b'{"message": {}}', "lacks 'content'"),
        (b"[]", "lacks 'message'"),
        (b"<html>", "not JSON"),
        (b'{"message": {"content": 3}}', "must contain a string"),
    ],
)
def test_wrong_answers(server, answer, message):
    server[1].append(answer)
    with pytest.raises(ValueError, match=message):
        query_llm("?")


def test_endless_answer(server, monkeypatch):
    monkeypatch.setattr(large_language_model, "_LARGEST_ANSWER", 10)
    with pytest.raises(ValueError, match="longer than 10 bytes"):
        query_llm("?")


def test_refused_before_anything_is_sent(server):
    with pytest.raises(TypeError, match="prompt must be a string"):
        query_llm(123)
    for address in ("a b", "host/path", "user@host", ""):
        with pytest.raises(ValueError, match="address must be"):
            query_llm("?", address=address)
    with pytest.raises(ValueError, match="endpoint must be"):
        query_llm("?", endpoint="/api\r\nX: y")
    assert server[0] == []
