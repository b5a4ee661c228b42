"""HTML and SVG as text, escaped by construction: only what is `Markup` is put in as it is."""

import html
import re
from collections.abc import Iterable
from typing import Final

_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")
_VOID: Final = frozenset({"meta", "br", "link"})

Attribute = str | int | float | None


class Markup(str):
    """Text that is markup already."""

    __slots__ = ()


def escaped(text: str) -> Markup:
    """The text as markup; what HTML cannot carry becomes a question mark."""
    if isinstance(text, Markup):
        return text
    return Markup(html.escape(_CONTROL.sub("?", text)))


def joined(parts: Iterable[str]) -> Markup:
    """Several pieces after each other."""
    return Markup("".join(escaped(part) for part in parts))


def element(name: str, /, *content: str, **attributes: Attribute) -> Markup:
    """An element; `class_` is class, `aria_label` aria-label, and None leaves an attribute out."""
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escaped(_text(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in _VOID:
        return Markup(f"<{name}{written}>")
    return Markup(f"<{name}{written}>{joined(content)}</{name}>")


def _text(value: str | int | float) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
