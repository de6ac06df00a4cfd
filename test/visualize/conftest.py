from importlib.util import find_spec

import pytest


class _Module(pytest.Module):
    """A file of tests, skipped where it cannot be imported without plotly."""

    def collect(self):
        try:
            return super().collect()
        except self.CollectError:
            if find_spec("plotly"):
                raise
            pytest.skip("plotly is not installed", allow_module_level=True)


def pytest_pycollect_makemodule(module_path, parent):
    return _Module.from_parent(parent, path=module_path)


@pytest.fixture
def opened(monkeypatch, tmp_path):
    """Return the pages that showing would have opened; keep them in the test's folder, on a desk without a display."""
    import webbrowser

    from odak.visualize.plotly import figures

    addresses = []
    monkeypatch.setattr(webbrowser, "open", lambda address, *a, **k: addresses.append(address))
    monkeypatch.setattr(figures, "_folder", tmp_path)
    monkeypatch.setattr(figures.page.renderers, "default", "browser")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    return addresses
