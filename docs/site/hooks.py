"""The site is the repository's own Markdown, under the same paths: every link holds in both.

mkdocs takes pages from one folder; here it gets those of the top, docs/ and the READMEs of the
plants. A link to a source file or notebook leads to a page that shows it, mathematics becomes
MathML, and the search needs no network. `rig_pages` puts rigs at work into some pages.
"""

import json
import posixpath
import re
from pathlib import Path
from typing import Any

import rig_pages
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("docs", "plants")
KINDS = (".md", ".png", ".gif", ".css", ".js")
MATH = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(?<=\]\()(?!\w+:)([^)#\s]+)(?=[)#])")
SHOWN = (
    ".ipynb",
    ".py",
    ".yaml",
    ".yml",
    ".dbc",
    ".json",
    ".csv",
)  # files that get a page of their own


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Give mkdocs the files of the repository, and pages of the source files they link to."""
    below = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*"))
    own = [path.relative_to(ROOT).as_posix() for path in below if path.suffix in KINDS]
    own = [*sorted(path.name for path in ROOT.glob("*.md")), *sorted(own)]
    found = [File(name, str(ROOT), config.site_dir, config.use_directory_urls) for name in own]
    theirs = [one for one in files if one.inclusion is not InclusionLevel.EXCLUDED]
    theme = [one for one in theirs if one.src_dir != config.docs_dir]
    linked = {to for name in own if name.endswith(".md") for to in _sources(name)}
    pages = [File.generated(config, f"{name}.md", content=_shown(name)) for name in sorted(linked)]
    texts = [(ROOT / name).read_text("utf-8") for name in own if name.endswith(".md")]
    rigs = rig_pages.made({one for text in texts for one in rig_pages.shown(text)})
    ready = [File.generated(config, at, abs_src_path=str(file)) for at, file in rigs.items()]
    return Files([*theme, *found, *pages, *ready])


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to source files to their pages; put in MathML and rigs in their places."""
    here = page.file.src_uri
    markdown = rig_pages.embedded(markdown, "../" * page.url.count("/"), files.src_uris)
    markdown = MATH.sub(lambda m: f'<div class="law">{_mathml(m[1])}</div>', markdown)
    return LINK.sub(lambda m: m[1] + ".md" * (_at(here, m[1]) + ".md" in files.src_uris), markdown)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Take the script by which pages on a disk are searched from the site, not from the network."""
    near = "../" * page.url.count("/") + "docs/site/iframe-worker.js"
    return output.replace("https://unpkg.com/iframe-worker/shim", near)


def _mathml(formula: str) -> str:
    """Return a formula as browsers show it, also without a font that knows where accents go."""
    found = convert(formula, display="block").replace(' accent="true"', "")
    return found.replace("&#x002D9;", ".").replace("&#x000A8;", "..")


def _at(page: str, link: str) -> str:
    return posixpath.normpath(posixpath.join(posixpath.dirname(page), link))


def _sources(page: str) -> set[str]:
    links = {_at(page, link) for link in LINK.findall((ROOT / page).read_text("utf-8"))}
    return {link for link in links if link.endswith(SHOWN) and (ROOT / link).is_file()}


def _shown(name: str) -> str:
    if name.endswith(".ipynb"):
        cells = json.loads((ROOT / name).read_text("utf-8"))["cells"]
        return "\n\n".join(part for cell in cells for part in _cell(cell))
    language = {"yml": "yaml", "py": "python"}.get(name.rpartition(".")[2], name.rpartition(".")[2])
    text = (ROOT / name).read_text("utf-8")
    return f"---\nsearch: {{exclude: true}}\n---\n# {name}\n\n````{language}\n{text}````\n"


def _cell(cell: dict[str, Any]) -> list[str]:
    """Return a cell of a notebook, and what it printed and drew."""
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return [source]
    found = [f"```python\n{source}\n```"]
    for output in cell["outputs"]:
        data = output.get("data", {})
        text = "".join(output.get("text", data.get("text/plain", ""))).rstrip()
        if "image/png" in data:
            found.append(f"![picture](data:image/png;base64,{''.join(data['image/png'].split())})")
        elif text:
            found.append(f"```text\n{text}\n```")
    return found
