"""Pages of HTML that stand alone: one file without script and network, in which names are text.

Its policy lets a browser load nothing but pictures that the file carries, and use no style but its
own, whatever a name of a log says. Readable on a phone, and on paper.
"""

import base64
import hashlib
import io
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from pcpc.drivers.errors import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = """
:root { color-scheme: light }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em;
       color: #111; background: #fff }
h1 { font-size: 1.5em; margin-bottom: 0.2em }
h2 { font-size: 1.2em; margin: 1.7em 0 0.4em; border-bottom: 2px solid #0072B2 }
h3 { font-size: 1em; margin-bottom: 0.3em }
table { border-collapse: collapse; font-size: 0.87em; margin: 0.8em 0 }
th, td { text-align: left; padding: 0.2em 0.9em 0.2em 0; border-bottom: 1px solid #D0D0D0;
         vertical-align: top }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums }
div.wide { overflow-x: auto }
code { font-size: 0.92em; overflow-wrap: anywhere } img { max-width: 100%; display: block }
pre { font-size: 0.8em; line-height: 1.35; background: #F6F6F6; padding: 0.8em; overflow: auto;
      max-height: 32em }
p.note { color: #555 } nav a { margin-right: 1em; white-space: nowrap } a { color: #0072B2 }
.verdict { border-left: 0.5em solid #D55E00; padding: 0.5em 1em; margin: 1em 0;
           background: #FCF1EA }
.verdict.ok { border-color: #0072B2; background: #EAF3F9 }
.verdict b { font-size: 1.25em } .verdict ul { margin: 0.3em 0; padding-left: 1.2em }
@media (max-width: 34em) {
  body { margin: 1em auto; padding: 0 0.7em }
  table { font-size: 0.7em } th, td { padding-right: 0.45em }
}
@media print {
  body { max-width: none; margin: 0; font-size: 10pt } nav { display: none }
  pre { max-height: none; white-space: pre-wrap } h2, h3 { break-after: avoid }
  tr, img, .verdict { break-inside: avoid } .verdict { print-color-adjust: exact }
}
"""
_HASH = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
_POLICY = f"default-src 'none'; img-src data:; style-src 'sha256-{_HASH}'"


def page(title: str, body: Sequence[str]) -> str:
    """Return the text of a page; `body`: its parts, which are HTML, empty ones left out."""
    parts = "\n".join(part for part in body if part)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<meta name="viewport" content="width=device-width"><title>{text(title)}</title>
<style>{_STYLE}</style></head><body>
{parts}
</body></html>
"""


def text(value: object) -> str:
    """Return a value as text that no browser takes for markup, and UTF-8 can say."""
    return escape(printable(str(value), "\xa0\n\t"))


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """Return a table of cells that are HTML already; `numbers`: columns aligned right."""

    def line(cells: Sequence[str], tag: str) -> str:
        right = [' class="n"' if i in numbers else "" for i in range(len(cells))]
        pairs = zip(right, cells, strict=True)
        return "".join(f"<{tag}{style}>{cell}</{tag}>" for style, cell in pairs)

    body = "\n".join(f"<tr>{line(row, 'td')}</tr>" for row in rows)
    first = f"<tr>{line(head, 'th')}</tr>\n" if any(head) else ""
    return f'<div class="wide"><table>{first}{body}</table></div>'


def png_of(figure: "Figure") -> bytes:
    """Return a figure as a PNG file's content."""
    written = io.BytesIO()
    if engine := figure.get_layout_engine():  # savefig would draw a second time for it
        engine.execute(figure)
        figure.set_layout_engine("none")
    figure.savefig(written, format="png")
    return written.getvalue()


def image(png: bytes, alt: str) -> str:
    """Return an element that carries a picture; `alt`: what it shows, in words."""
    data = base64.b64encode(png).decode()
    return f'<img alt="{text(alt)}" src="data:image/png;base64,{data}">'
