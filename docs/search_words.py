"""Hook of MkDocs: words under which the search of the site finds a section besides those that it contains.

The search in the browser compares beginnings of words and knows neither endings, nor other spellings, nor other words for
a thing. Each section of its index is given, of `odak._find` and `odak._moved`: British and American spellings of all its
words; and, of its title, other forms that stand anywhere on the site, synonyms, and names in other libraries.
"""

import json
import re
from collections import defaultdict
from html import unescape
from pathlib import Path

from odak._find import SYNONYMS, spellings, stem
from odak._moved import other_words

_WORD = re.compile(r"[A-Z]?[a-z]{2,}|[A-Z]{2,}")


def _words(text):
    """Return the words of a section, in small letters, those of CamelCase and snake_case apart."""
    return {word.casefold() for word in _WORD.findall(re.sub(r"<[^>]*>", " ", unescape(text)))}


def with_more_words(docs):
    """Return the sections of an index with more words: those of titles as tags, which count as the title does.

    Parameters
    ----------
    docs : list of dict
        Sections with "title" and "text", as the search plugin writes them.
    """
    forms, groups = defaultdict(set), defaultdict(set)
    for entry in docs:
        for word in _words(f"{entry['title']} {entry['text']}"):
            forms[stem(word)].add(word)
    for line in SYNONYMS:
        for word in line.split():
            groups[stem(word)] |= set(line.split())
    for entry in docs:
        titled = _words(entry["title"])
        spelt = {other for word in _words(entry["text"]) for other in spellings(word)} - _words(entry["text"])
        if spelt:
            entry["text"] += f"<p>{' '.join(sorted(spelt - titled))}</p>"
        more = {word for one in titled for word in (*spellings(one), *forms[stem(one)], *groups[stem(one)])}
        name = next(
            (name for name in unescape(re.sub(r"<[^>]*>", " ", entry["title"])).split() if name in other_words()), ""
        )
        more |= _words(other_words().get(name, "")) | {word for one in more for word in spellings(one)}
        if "#odak." in entry["location"]:
            # Who types a name wants its entry, before the guides that speak of it.
            entry["boost"] = 2
        if more - titled:
            entry["tags"] = [" ".join(sorted(more - titled))]
    return docs


def on_post_build(config):
    """Complete the index that the search plugin has written."""
    path = Path(config["site_dir"]) / "search" / "search_index.json"
    index = json.loads(path.read_text(encoding="utf-8"))
    with_more_words(index["docs"])
    path.write_text(json.dumps(index, ensure_ascii=False, separators=(",", ":")), encoding="utf-8")
