"""The built site: links resolve, pictures have words, browsers have nothing to complain of, phones can read it."""

import asyncio
import functools
import http.server
import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path
from urllib.parse import unquote, urldefrag, urljoin, urlparse

import pytest

pytest.importorskip("mkdocs", reason="what builds the site is not installed: pip install -r docs/requirements.txt")

from bs4 import BeautifulSoup
from documentation import ROOT, script

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
# A page inside a frame as wide as a phone, and what it says of itself: how many pixels it is wider than that.
PHONE = """<!doctype html><title>phone</title><iframe src="/{}" width="390" height="800"></iframe>
<script>onmessage = event => document.documentElement.dataset.overflow = event.data</script>"""
WALK = Path(__file__).with_name("walk.html")
PROBE = b"""<script>addEventListener("load", () => setTimeout(() =>
parent.postMessage(document.documentElement.scrollWidth - innerWidth, "*"), 300))</script>"""
ROLE = re.compile(r":(?:func|meth|class|mod|attr|data|exc|obj|ref):`?\w?")
READ_IN_A_BROWSER = ("index.html", "guides", "notes", "course", "where_to_begin", "installation")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = ["mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    subprocess.run([sys.executable, "-m", *command], cwd=ROOT, check=True, env=environment)
    return folder


@functools.cache
def soup_of(path):
    return BeautifulSoup(path.read_text(encoding="utf-8"), "html.parser")


def pages(site):
    return [path for path in sorted(site.rglob("*.html")) if path.name != "404.html"]


def file_of(site, page, link):
    """Return the file behind a relative link on a page, and the anchor."""
    base = "http://site/" + page.relative_to(site).as_posix()
    address, anchor = urldefrag(urljoin(base, link))
    path = site / unquote(urlparse(address).path).lstrip("/")
    return (path / "index.html" if path.is_dir() else path), unquote(anchor)


def test_links_and_anchors_resolve(site):
    broken = []
    for page in pages(site):
        for link in {a["href"] for a in soup_of(page).find_all("a", href=True)}:
            if urlparse(link).scheme:
                continue
            path, anchor = file_of(site, page, link)
            if not path.is_file():
                broken.append(f"{page.relative_to(site)}: {link}")
            elif anchor and path.suffix == ".html" and soup_of(path).find(id=anchor) is None:
                broken.append(f"{page.relative_to(site)}: no anchor {link}")
    assert not broken, "\n".join(broken)


def test_nothing_is_fetched_from_elsewhere(site):
    for page in pages(site):
        for tag, name in (("script", "src"), ("img", "src"), ("link", "href"), ("iframe", "src")):
            for element in soup_of(page).find_all(tag, **{name: True}):
                away = urlparse(element[name]).netloc and "canonical" not in element.get("rel", ())
                assert not away, f"{page.relative_to(site)} fetches {element[name]}"


def test_pictures_have_words(site):
    for page in pages(site):
        for image in soup_of(page).find_all("img"):
            words = image.get("alt", "")
            assert words and "No description" not in words, f"{page.relative_to(site)}: {image.get('src', '')[:80]}"


def test_equations_are_drawn(site):
    for page in pages(site):
        left = soup_of(page).select(".arithmatex")
        left += [node for node in soup_of(page).select(".jp-RenderedMarkdown") if "$" in _text_without_code(node)]
        assert not left, f"{page.relative_to(site)}: {left[0].get_text()[:200]}"


def _text_without_code(node):
    return "".join(text for text in node.find_all(string=True) if text.find_parent(["pre", "code"]) is None)


def test_no_role_and_no_tex_command_is_printed(site):
    for page in pages(site):
        soup = soup_of(page)
        role = ROLE.search(_text_without_code(soup) + "".join(node.get_text() for node in soup.select(".doc code")))
        assert role is None, f"{page.relative_to(site)} prints {role[0]}"
        for formula in soup.find_all("math"):
            assert "\\" not in formula.get_text(), f"{page.relative_to(site)}: {formula.get_text()}"


def test_every_public_name_has_one_entry_and_earlier_anchors_stay(site):
    reference = script("reference")
    listed = [
        heading["id"]
        for page in pages(site)
        for heading in soup_of(page).select("h3.doc-heading")
        if heading["id"] in reference.entries()
    ]
    assert sorted(listed) == sorted(reference.entries())
    for page, anchor, path in reference.former_anchors():
        assert soup_of(site / "reference" / page / "index.html").find(id=anchor), f"{page}: {anchor}, now {path}"


@pytest.fixture(scope="module")
def address(site):
    class Handler(http.server.SimpleHTTPRequestHandler):
        def do_GET(self):
            if self.path.startswith("/phone/"):
                body = PHONE.format(self.path.removeprefix("/phone/")).encode()
            elif self.path.startswith("/walk/"):
                body = WALK.read_text(encoding="utf-8").replace("WIDTH", self.path.removeprefix("/walk/")).encode()
            else:
                path, _ = file_of(site, site / "index.html", self.path.lstrip("/"))
                if path.suffix != ".html" or not path.is_file():
                    return super().do_GET()
                body = path.read_bytes().replace(b"</body>", PROBE + b"</body>")
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            return self.wfile.write(body)

        def log_message(self, *_):
            """Keep the tests' output quiet."""

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}/"
    server.shutdown()
    server.server_close()


def opened(url, profile):
    """Return what a headless browser made of a page, and what it wrote to its console."""
    from odak.visualize.plotly import find_browser

    flags = (
        "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking "
        "--disable-component-update --disable-sync --enable-logging=stderr --virtual-time-budget=4000 --dump-dom"
    )
    command = [find_browser(), *flags.split(), f"--user-data-dir={profile}", url]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    return done.stdout, re.findall(r"CONSOLE[^\]]*\] (.*)", done.stderr)


@pytest.mark.browser
def test_browser_has_nothing_to_complain_of_and_a_phone_can_read_it(site, address, tmp_path):
    names = [page.relative_to(site).as_posix() for page in pages(site)]
    names = [name for name in names if name.startswith(READ_IN_A_BROWSER)]
    assert len(names) > 20
    complaints = []
    for name in names:
        html, console = opened(f"{address}phone/{name}", tmp_path)
        overflow = re.search(r'data-overflow="(-?\d+)"', html)
        complaints += [f"{name}: {line}" for line in console]
        if overflow is None or int(overflow[1]) > 0:
            complaints.append(f"{name}: wider than a phone by {overflow and overflow[1]} px")
    assert not complaints, "\n".join(complaints)


async def walked(url):
    """Return the report of a walk through the site in a real browser."""
    import choreographer

    from odak.visualize.plotly import find_browser

    async with choreographer.Browser(path=find_browser(), headless=True, enable_sandbox=False) as browser:
        tab = await browser.create_tab(url)
        for _ in range(240):
            await asyncio.sleep(0.5)
            expression = {"expression": "document.documentElement.dataset.report || ''"}
            answer = await tab.send_command("Runtime.evaluate", params=expression)
            if answer["result"]["result"]["value"]:
                return json.loads(answer["result"]["result"]["value"])
    raise TimeoutError(url)


@pytest.mark.browser
@pytest.mark.parametrize("width", [1400, 390])
def test_a_reader_walks_from_home_to_the_course(address, width):
    pytest.importorskip("choreographer")
    report = asyncio.run(walked(f"{address}walk/{width}"))
    assert not report["faults"], "\n".join(report["faults"])
    assert len(report["steps"]) == 9, report["steps"]


def test_every_chapter_is_in_the_site(site):
    built = {path.parent.name for path in (site / "course").rglob("index.html")}
    assert {path.stem for path in Path(ROOT, "docs", "course").glob("*.ipynb")} <= built
