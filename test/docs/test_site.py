"""The built site: links resolve, pictures have words, browsers have nothing to complain of, phones can read it."""

import asyncio
import contextlib
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
from searched import SEARCHED, found_by_title

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
# A page inside a frame as wide as a phone, and the number of pixels by which its content is wider.
PHONE = """<!doctype html><title>phone</title><iframe src="/{}" width="390" height="800"></iframe>
<script>onmessage = event => document.documentElement.dataset.overflow = event.data</script>"""
WALK = Path(__file__).with_name("walk.html")
PROBE = b"""<script>addEventListener("load", () => setTimeout(() =>
parent.postMessage(document.documentElement.scrollWidth - innerWidth, "*"), 300))</script>"""
ROLE = re.compile(r":(?:func|meth|class|mod|attr|data|exc|obj|ref):`?\w?")
READ_IN_A_BROWSER = ("index.html", "guides", "notes", "course", "where_to_begin", "installation")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return the folder of the site: the one that the environment names, else built here."""
    if built := os.environ.get("ODAK_SITE"):
        return Path(built)
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


def test_public_names_have_one_entry_and_earlier_anchors_stay(site):
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


def test_the_search_finds_what_readers_call_otherwise(site):
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    assert index["config"]["pipeline"] == ["stopWordFilter"]  # beginnings of words are compared, not their stems
    assert index["config"]["fields"]["tags"]["boost"] == index["config"]["fields"]["title"]["boost"]
    for words, location in SEARCHED.items():
        assert location in found_by_title(index, words), words


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
            """Suppress the log of the server."""

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
def test_browser_reports_no_errors_and_a_phone_can_read_it(site, address, tmp_path):
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


@contextlib.asynccontextmanager
async def tab_of(url):
    """Open a page in a real browser; give a function that evaluates JavaScript there, and the tab."""
    import choreographer

    from odak.visualize.plotly import find_browser

    async with choreographer.Browser(path=find_browser(), headless=True, enable_sandbox=False) as browser:
        tab = await browser.create_tab(url)

        async def value(expression, attempts=1):
            for _ in range(attempts):
                parameters = {"expression": expression, "awaitPromise": True, "returnByValue": True}
                answer = await tab.send_command("Runtime.evaluate", params=parameters)
                found = answer["result"]["result"].get("value")
                if found or attempts == 1:
                    return found
                await asyncio.sleep(0.5)
            raise TimeoutError(f"{url}: {expression}")

        yield value, tab


async def walked(url):
    """Return the report of a walk through the site in a real browser."""
    async with tab_of(url) as (value, _):
        return json.loads(await value("document.documentElement.dataset.report || ''", 240))


async def explored(url):
    """Move all sliders of a page, then point at, enlarge and recolour its figures as a reader does."""
    found = {}
    async with tab_of(url) as (value, tab):
        await value("document.readyState === 'complete' && document.querySelectorAll('.frames').length > 0", 60)
        found["sliders"] = await value("""(async () => {
            const report = []
            for (const figure of document.querySelectorAll(".frames")) {
                const [slider, frame, label] = ["input", ".frame", "output"].map(name => figure.querySelector(name))
                const labels = JSON.parse(figure.dataset.labels), before = label.textContent
                const image = new Image()
                image.src = getComputedStyle(frame).backgroundImage.slice(5, -2)
                await image.decode()
                slider.value = labels.length - 1
                slider.dispatchEvent(new Event("input"))
                report.push([image.naturalHeight > 0, before !== label.textContent, label.textContent === labels.at(-1),
                    frame.style.backgroundPositionY === "100%"])
            }
            return report
        })()""")
        drawn = "[...document.querySelectorAll('.plotly-figure')].filter(f => f.querySelector('.main-svg')).length"
        names = await value("[...document.querySelectorAll('.plotly-figure')].map(f => f.dataset.figure)")
        for index, name in enumerate(names):
            await value(f"document.querySelectorAll('.plotly-figure')[{index}].scrollIntoView({{block: 'center'}}), 1")
            await value(f"{drawn} > {index}", 60)
            found[name.rpartition("/")[2]] = True
        await value("gd = document.querySelector('[data-figure$=\"glasses.json\"]'), 1")
        await value("gd.scrollIntoView({block: 'center', behavior: 'instant'}), 1")
        place = """(k => {
            const box = gd.getBoundingClientRect(), { xaxis, yaxis } = gd._fullLayout, data = gd.calcdata[0][k]
            return [box.x + xaxis._offset + xaxis.l2p(data.x), box.y + yaxis._offset + yaxis.l2p(data.y)]
        })"""

        async def mouse(kind, x, y, **more):
            parameters = {"type": f"mouse{kind}", "x": x, "y": y, **more}
            await tab.send_command("Input.dispatchMouseEvent", params=parameters)
            await asyncio.sleep(0.3)

        spot = None
        while spot != (spot := await value(f"{place}(0)")):  # until the page has come to rest
            await asyncio.sleep(1)
        x, y = spot
        await mouse("Moved", x - 3, y)
        await mouse("Moved", x, y)
        found["name"] = await value("gd.data[0].text[0]")
        found["hover"] = await value("gd.querySelector('.hovertext')?.textContent || ''", 60)
        found["before"] = await value("gd._fullLayout.xaxis.range.slice()")
        range_now = "JSON.stringify(gd._fullLayout.xaxis.range)"
        await value(f"earlier = {range_now}")
        await mouse("Pressed", x, y, button="left", clickCount=1)
        await mouse("Moved", x + 60, y - 60, button="left", buttons=1)
        await mouse("Moved", x + 120, y - 90, button="left", buttons=1)
        await mouse("Released", x + 120, y - 90, button="left", clickCount=1)
        await value(f"{range_now} !== earlier", 60)
        found["after"] = await value("gd._fullLayout.xaxis.range.slice()")
        found["light"] = await value("light = gd.layout.font.color")
        await value("document.body.setAttribute('data-md-color-scheme', 'slate'), 1")
        await value("gd.layout.font.color !== light", 60)
        found["dark"] = await value("gd.layout.font.color")
    return found


@pytest.mark.browser
def test_figures_can_be_explored(address):
    pytest.importorskip("choreographer")
    found = asyncio.run(explored(f"{address}interactive/"))
    assert len(found["sliders"]) == 8 and all(map(all, found["sliders"])), found["sliders"]
    assert found["name"] in found["hover"] and "Abbe number" in found["hover"]
    (left, right), (before_left, before_right) = found["after"], found["before"]
    assert abs(right - left) < 0.6 * abs(before_right - before_left)
    assert found["light"] != found["dark"]


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
