"""Attributes that are set after others were computed from them."""

from typing import Any


class Prepared:
    """Base of classes that compute some of their attributes from others.

    A subclass lists in `_follow` the attributes that may be set, with the name of the method that then computes anew
    what depends on them, and in `_fixed` those that may not, since the whole object was prepared for them.
    """

    _fixed: tuple[str, ...] = ()
    _follow: dict[str, str] = {}  # noqa: RUF012

    def __setattr__(self, name: str, value: Any) -> None:
        known = any(name in (vars(self).get(place) or ()) for place in ("_modules", "_buffers")) or name in vars(self)
        if known and name in self._fixed:
            kind = type(self).__name__
            raise AttributeError(f"{name} cannot be set: the whole {kind} was prepared for it; make a new {kind}")
        super().__setattr__(name, value)
        if known and name in self._follow:
            getattr(self, self._follow[name])()
