"""Progress bars of tqdm, in notebooks as widgets where these can be shown."""

import importlib.util
import sys

if "ipykernel" in sys.modules and importlib.util.find_spec("ipywidgets") is not None:
    from tqdm.auto import tqdm
else:
    # Without ipywidgets, tqdm.auto warns in each notebook and gives the same.
    from tqdm import tqdm

__all__ = ["tqdm"]
