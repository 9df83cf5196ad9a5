"""HTML and SVG elements that escape what they are given, and the shell of a self-contained page.

Plain strings are text and are escaped; only `Html`, which `el` makes, passes through. So nothing that came from a file
(a capture id, a warning) can become markup.
"""

from __future__ import annotations

import html
import json
from importlib import resources
from typing import Any

VOID = {"img", "meta", "br", "hr", "input"}
CONTENT_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""The browser itself refuses any request that the page might make."""
SCRIPTS = ("renderers.js", "viewer.js")


class Html(str):
    """Markup that is safe to embed."""

    __slots__ = ()


def el(name: str, *children: str | None, **attributes: Any) -> Html:
    """An element. ``class_`` and ``for_`` lose their underscore, other underscores become hyphens; None is left out."""
    opening = "".join(_attribute(key, value) for key, value in attributes.items() if value is not None)
    if name in VOID:
        return Html(f"<{name}{opening}>")
    return Html(f"<{name}{opening}>{join(*children)}</{name}>")


def join(*children: str | None) -> Html:
    """Children one after the other: text escaped, markup as it is, None left out."""
    return Html("".join(child if isinstance(child, Html) else html.escape(child) for child in children if child))


def comment(text: str) -> Html:
    """``<!-- text -->``; used as a mark that later writers find."""
    return Html(f"<!-- {text} -->")


def json_script(identifier: str, data: Any) -> Html:
    """A block of JSON that scripts read by its id; no ``</script>`` can occur in it."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return el("script", Html(text), type="application/json", id=identifier)


def asset(name: str) -> Html:
    """The text of a file that is packaged beside this module (.css, .js)."""
    return Html((resources.files("lfrig.processing.report") / name).read_text(encoding="utf-8"))


def page(title: str, *body: str | None) -> str:
    """A whole document with the style sheet and the viewer's script inside."""
    head = el(
        "head",
        el("meta", charset="utf-8"),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{CONTENT_POLICY}">'),
        el("meta", name_="viewport", content="width=device-width, initial-scale=1"),
        el("meta", name_="color-scheme", content="light dark"),
        el("title", title),
        el("style", asset("style.css")),
    )
    scripts = (el("script", asset(name)) for name in SCRIPTS)
    return f'<!doctype html>\n<html lang="en">\n{head}\n{el("body", *body, *scripts)}\n</html>\n'


def section(title: str, *children: str | None, id: str, lead: str | None = None) -> Html:
    """A titled part of the page with one line that says what is to be seen."""
    return el(
        "section",
        el("h2", title),
        el("p", lead, class_="lead") if lead else None,
        *children,
        id=id,
        aria_label=title,
    )


def figure(picture: Html, caption: str | None, *extra: str | None, class_: str | None = None) -> Html:
    """A picture with its caption and whatever belongs under it (a colour bar)."""
    return el("figure", picture, *extra, el("figcaption", caption) if caption else None, class_=class_)


def image(uri: str, alt: str, width: int, height: int, class_: str | None = None) -> Html:
    """An embedded picture; ``width`` and ``height`` [px] reserve its place."""
    return el("img", src=uri, alt=alt, width=width, height=height, class_=class_, decoding="async")


def table(head: list[str], rows: list[list[str | Html]], caption: str | None = None) -> Html:
    """A table whose first column names its row."""
    body = [
        el("tr", el("th", row[0], scope="row"), *(el("td", cell) for cell in row[1:]))
        for row in rows
    ]  # fmt: skip
    header = el("tr", *(el("th", cell, scope="col") for cell in head))
    return el(
        "div",
        el("table", el("caption", caption) if caption else None, el("thead", header), el("tbody", *body)),
        class_="table",
    )


def _attribute(key: str, value: Any) -> str:
    name = key.rstrip("_").replace("_", "-")
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return f' {name}="{html.escape(text, quote=True)}"'
