"""The bill of materials that a wheel carries: CycloneDX 1.6 in .dist-info/sboms/, as PEP 770 says.

In it are

    files of others     that lie in the wheel: NAME.js beside NAME-LICENSE.txt, its first line has
                        the version
    packages            that pcpc needs (required) or can use (optional), as pyproject.toml has them
    compilers           whose machine code a released wheel brings: the numba and llvmlite here

It has no time and no random number: one source gives one bill.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from setuptools.command.bdist_wheel import bdist_wheel

NAME = "sboms/pcpc.cdx.json"
_VERSION = re.compile(r"\d+\.\d+\.\d+")
_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^\]]*\])?([^;]*)")


class BillWheel(bdist_wheel):
    """`bdist_wheel` with the bill in it."""

    def write_wheelfile(self, wheelfile_base: str, *more: Any, **named: Any) -> None:
        """Write WHEEL and, where the files of the wheel lie beside it, the bill."""
        super().write_wheelfile(wheelfile_base, *more, **named)
        info = Path(wheelfile_base)
        if not (info.parent / "pcpc").is_dir():  # an editable one has no files
            return
        about = self.distribution
        extras = {name: wanted for name, wanted in about.extras_require.items() if name != "test"}
        found = bill(
            about.get_version(),
            info.parent / "pcpc",
            about.install_requires,
            [one for wanted in extras.values() for one in wanted],
        )
        (info / NAME).parent.mkdir()
        (info / NAME).write_text(json.dumps(found, indent=1) + "\n", "utf-8")


def bill(own: str, folder: Path, needed: Iterable[str], usable: Iterable[str]) -> dict[str, Any]:
    """Return the bill of version `own`, whose files lie in `folder`.

    `needed`, `usable`: requirements as in pyproject.toml.
    """
    root = {
        "type": "application", "bom-ref": "pcpc", "name": "pcpc", "version": own,
        "purl": f"pkg:pypi/pcpc@{own}", "licenses": [{"license": {"id": "MIT"}}],
    }  # fmt: skip
    parts = [
        *_vendored(folder),
        *_packages(needed, "required"),
        *_packages(usable, "optional"),
        *(_compilers() if any(folder.glob("drivers/compiled/shipped/*/*")) else ()),
    ]
    by_ref = {one["bom-ref"]: one for one in reversed(parts)}  # what is needed goes first
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": root},
        "components": [by_ref[ref] for ref in sorted(by_ref)],
        "dependencies": [{"ref": "pcpc", "dependsOn": sorted(by_ref)}],
    }


def _vendored(folder: Path) -> Iterator[dict[str, Any]]:
    for licence in sorted(folder.rglob("*-LICENSE.txt")):
        name = licence.name.removesuffix("-LICENSE.txt")
        content = licence.with_name(f"{name}.js").read_bytes()
        found = _VERSION.search(content.split(b"\n")[0].decode())
        if found is None or "MIT" not in licence.read_text("utf-8"):
            raise ValueError(f"{licence}: version or licence of {name}.js is not known")
        yield {
            "type": "library", "bom-ref": name, "name": name, "version": found[0],
            "purl": f"pkg:npm/{name}@{found[0]}", "licenses": [{"license": {"id": "MIT"}}],
            "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(content).hexdigest()}],
        }  # fmt: skip


def _packages(wanted: Iterable[str], scope: str) -> Iterator[dict[str, Any]]:
    for one in wanted:
        found = _REQUIREMENT.match(one)
        assert found is not None, one
        name = re.sub("[-_.]+", "-", found[1]).lower()
        if name != "pcpc":  # an extra of its own
            yield {
                "type": "library", "bom-ref": f"pypi/{name}", "name": name, "scope": scope,
                "purl": f"pkg:pypi/{name}",
                "properties": [{"name": "pcpc:requirement", "value": found[2].strip() or "any"}],
            }  # fmt: skip


def _compilers() -> Iterator[dict[str, Any]]:
    for name in ("numba", "llvmlite"):
        try:
            made = version(name)
        except PackageNotFoundError:
            raise ValueError(f"{name}, which compiled the shipped code, is not here") from None
        yield {
            "type": "application", "bom-ref": f"compiler/{name}", "name": name, "version": made,
            "purl": f"pkg:pypi/{name}@{made}", "scope": "excluded",
        }  # fmt: skip
