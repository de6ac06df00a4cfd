"""What readers type in the search of the site, and what it finds as the browser would."""

import re

# Words that a reader types in the search of the site, and a section that they must find by its title or other words for
# it.
SEARCHED = {
    "tolerancing": "gallery/lenses/tolerances/",
    "load zmx": "reference/learn_raytracing_system/#odak.learn.raytracing.system.read_zmx",
    "visualize field": "reference/visualize/#odak.visualize.plotly.field_show",
    "visualise field": "reference/visualize/#odak.visualize.plotly.field_show",
    "Laguerre Gauss": "reference/wave/#odak.wave.laguerre_gaussian_beam",
    "polarization": "guides/polarisation/",
    "color difference": "notes/published_results/#colour-differences-sharma-wu-and-dalal-2005",
    "colour difference": "reference/learn_perception_color/#odak.learn.perception.color_difference",
    "propagating beam": "reference/wave_classical/#odak.wave.propagate_beam",
}


def found_by_title(index, words):
    """Return the sections that the search in the browser finds by titles and tags: beginnings of words, all of them.

    It divides both by the separator of the index, with the pipeline of which nothing is left but stop words.
    """
    separator = re.compile(index["config"]["separator"])

    def divided(text):
        return [part.casefold() for part in separator.split(re.sub(r"<[^>]*>", "", text)) if part]

    found = []
    for entry in index["docs"]:
        known = [word for text in (entry["title"], *entry.get("tags", ())) for word in divided(text)]
        if all(any(word.startswith(sought) for word in known) for sought in divided(words)):
            found.append(entry["location"])
    return found
