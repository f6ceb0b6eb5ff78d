"""The rig of a log, and from where its laws and its evaluation are taken.

A log carries its evaluation and what laws from outside the project need, see
`executive.own_laws.carried_files`. The project's own are those of this installation. Python out of
a log that somebody else wrote may do anything, so it is not run unasked:

    by default   files that lie where the log says, with the content that it records
    --rig RIG    the same, below the folder of a rig file
    --law FILE   this file, also with other content
    --trust      the log's own copies, unpacked and removed again
    --fmu FILE   an FMU of the run, which a log never holds

Where not all of them lie in their places, the files are laid out anew as they lay to each other,
and what a law opens by its old path it gets from there.
"""

import builtins
import hashlib
import io
import json
import os
import posixpath
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, TypeGuard

import msgspec
import numpy as np
import yaml

from pcpc.executive.log import reader as logs
from pcpc.executive.own_laws import carried_files, trial
from pcpc.executive.own_laws.modules import PROJECT, project_file
from pcpc.executive.rig import fmu, yamlfile
from pcpc.executive.rig.law_lookup import present_name
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import ROLES
from pcpc.plants.judging import effective_rig
from pcpc.tools.after.log.packages import check_dialects, packages_of
from pcpc.tools.after.trust import FOLDER, Trust

MOST_UP = 64  # folders that a file may lie above its rig
_DRAWINGS = "plants/*/drawing.py", "tools/make/template/**/drawing.py"


@dataclass(frozen=True)
class RunFile:
    """A file of the run; `content` None if the log does not carry it, `path` "" if it is unknown.

    `laws`: the texts by which the log's rig names it, `given`: by which a law opened it.
    """

    name: str
    path: str
    sha256: str
    laws: tuple[str, ...]
    given: tuple[str, ...]
    content: bytes | None = None

    def shown(self) -> str:
        """Return name and hash as messages show them."""
        return f"{self.name} (sha256 {self.sha256[:16]})"


@contextmanager
def rig_of(
    head: logs.Log, trust: Trust, controller: str | None, settings: Sequence[str], whole: bool
) -> Iterator[Rig]:
    """Yield the rig of a log, its files in a temporary folder; LogError, RigError.

    While it is in use, laws open what the run's laws opened. `whole`: with its evaluation and its
    schedule, as for another run.
    """
    with tempfile.TemporaryDirectory(prefix=FOLDER) as text:
        folder = Path(text)
        data = _resolved_rig(head, folder, whole)
        check_dialects(head, data)
        if whole and isinstance(given := data.get("evaluation"), dict):
            given["file"] = str(_evaluation(head, str(given.get("file")), folder, trust)[0])
        data |= {} if whole else {"evaluation": None}
        for entry in _entries(data):
            if entry.get("law") == fmu.LAW and (file := fmu_file(entry, folder, trust.fmu)):
                entry["file"] = str(file)
        place = folder / "rig.yaml"
        rig = load_rig(place, controller, settings, resolve=False, text=yamlfile.dump(data))
        files = carried_by(head)
        where = _places(head, files, folder, trust)
        by_law = {law: where[file] for file in files for law in file.laws}
        for keys, law in rig.laws():
            if rig.document.place(keys).option or not (path := _path_of(head, law, by_law)):
                continue
            target: Any = data
            for key in keys[:-1]:
                target = target[key]
            _, colon, attribute = law.partition(":")
            target[keys[-1]] = f"{path}{colon}{attribute}"
        with opened_from(_redirections(files, where)), trial.without_trials():
            yield load_rig(place, controller, settings, text=yamlfile.dump(data))


def _resolved_rig(head: logs.Log, folder: Path, whole: bool = False) -> dict[str, Any]:
    """Return the effective rig of a log, with its DBC file in `folder`; LogError."""
    names = [name for name in head.attachments if name.endswith("rig-resolved.yaml")]
    if not names:
        raise logs.LogError(f"{head.path}: holds no rig, so it cannot be replayed")
    text = head.attachments[names[0]]
    try:
        plain = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, ValueError, RecursionError):
        plain = {}  # yamlfile says where
    if isinstance(plain, dict) and "base" in plain:
        raise logs.LogError(f"{head.path}: its rig has a base file, which no rig in a log has")
    data = yamlfile.load(folder / "rig.yaml", text).data
    database = PurePosixPath(str(data.get("dbc", ""))).name
    data |= {"dbc": database if database.endswith(".dbc") else "log.dbc"}
    (folder / data["dbc"]).write_text(head.attachments.get(database, ""), encoding="utf-8")
    for name in (entry["file"] for entry in _entries(data) if isinstance(entry.get("file"), str)):
        (folder / PurePosixPath(name).name).write_text(head.attachments.get(name, ""), "utf-8")
    if not whole:
        data["schedule"], data["note"] = [], []  # its tunings are in the log
    if isinstance(data.get("plant"), dict):
        data["plant"]["parameters_file"] = None
    return data


def fmu_file(entry: Mapping[str, Any], folder: Path, fmus: Sequence[str]) -> Path | None:
    """Return the file of an FMU that the log's block `entry` was, if it was given; LogError."""
    name = PurePosixPath(str(entry.get("file"))).name
    try:
        about = json.loads((folder / name).read_text("utf-8"))
        wanted, model = str(about["sha256"]), str(about["name"])
    except (OSError, ValueError, KeyError, TypeError):
        return None  # whoever reads it says so
    for text in fmus:
        path = Path(text).resolve()
        if not carried_files.is_ordinary(path):
            raise logs.LogError(f"--fmu {text}: no such file")
        if (found := carried_files.sha256(path)) == wanted:
            return path
        if len(fmus) == 1:
            what = f"the run's {model} has sha256 {wanted[:16]}, this one {found[:16]}"
            raise logs.LogError(f"--fmu {text}: another FMU: {what}")
    return None


def _entries(data: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the blocks of all nodes, as far as they are some, and the drive with its file."""
    for node in [one for role in ROLES if isinstance(one := data.get(role), dict)]:
        blocks, drive = node.get("blocks"), node.get("drive")
        yield from filter(_is_mapping, blocks.values() if _is_mapping(blocks) else ())
        yield from [{"file": drive.get("eds")}] if _is_mapping(drive) else ()


def _is_mapping(value: object) -> TypeGuard[dict[str, Any]]:
    return isinstance(value, dict)


def judged_rig(
    head: logs.Log, folder: Path, trust: Trust | None, settings: Sequence[str] = ()
) -> tuple[Rig, str]:
    """Return the rig of a log with its evaluation, no law loaded; LogError, RigError.

    And a word on the evaluation, if it is not the one of the run. `settings`: as --set. Without
    `trust` it has none.
    """
    data, note = _resolved_rig(head, folder), ""
    if trust is None:
        data["evaluation"] = None
    elif isinstance(given := data.get("evaluation"), dict):
        path, note = _evaluation(head, str(given.get("file")), folder, trust)
        given["file"] = str(path)
    text = yamlfile.dump(data)
    return load_rig(folder / "rig.yaml", None, settings, resolve=False, text=text), note


def _evaluation(head: logs.Log, name: str, folder: Path, trust: Trust) -> tuple[Path, str]:
    """Return the file of a log's evaluation, and a word if it is another one; LogError."""
    files, own_file = carried_by(head, "judges"), project_file(name)
    same = own_file is not None and (not files or files[0].sha256 == carried_files.sha256(own_file))
    if own_file is not None and (same or not trust.trust):
        return (
            own_file,
            "" if same else f"{name} differs from the log's own; --trust uses the log's",
        )
    if not files:  # logs of earlier versions
        names = {facts.get("rig", "") for facts in head.metadata.values()}
        shipped = [path for path in PROJECT.glob("plants/*/rigs/*.yaml") if path.stem in names]
        place = trust.rig or next(iter(shipped), None)
        evaluation = load_rig(place, resolve=False).evaluation if place else None
        if evaluation is None:
            raise logs.LogError(f"{head.path}: does not carry its evaluation {name}; try --rig RIG")
        return Path(evaluation.file), ""
    return _places(head, files, folder, trust)[files[0]], ""


def drawing_of_log(head: logs.Log, folder: Path, trust: Trust) -> tuple[Path | None, str]:
    """Return the file of a log's drawing, None without one, and a word if it is another one.

    LogError as for its evaluation: the log's own copy is run with --trust only.
    """
    files = carried_by(head, "draws")
    digest = files[0].sha256 if files else ""
    evaluation = project_file(str((effective_rig(head).get("evaluation") or {}).get("file")))
    shipped = evaluation.with_name("drawing.py") if evaluation else None
    ours = (file for place in _DRAWINGS for file in PROJECT.glob(place))
    for own in [shipped] if shipped else ours:
        if own.is_file() and carried_files.sha256(own) == digest:
            return own, ""
    if shipped and shipped.is_file() and not (files and trust.trust):
        word = f"{shipped} differs from the log's own; --trust uses the log's"
        return shipped, word if files else ""
    return (_places(head, files, folder, trust)[files[0]] if files else None), ""


def carried_by(head: logs.Log, kind: str = "") -> list[RunFile]:
    """Return the files that a log carries for its laws; its evaluation's, if `kind` is judges.

    Those of its drawing, if it is draws. LogError if it names them wrongly.
    """
    contents = {hashlib.sha256(data).hexdigest(): data for data in head.files.values()}
    files_by_name: dict[str, RunFile] = {}
    for node in head.node.values():
        for entry in node.description.get("files", ()):
            if kind != next((one for one in ("judges", "draws") if entry.get(one)), ""):
                continue
            try:
                run_file = msgspec.convert(entry, RunFile)
            except msgspec.ValidationError as error:
                what = f"an entry of the files it carries is damaged ({error})"
                raise logs.LogError(f"{head.path}: {what}") from None
            known = files_by_name.get(run_file.name, run_file)
            if known.sha256 != run_file.sha256:
                raise logs.LogError(f"{head.path}: {run_file.name} changed while the run started")
            laws, given = (known.laws, known.given) if known is not run_file else ((), ())
            files_by_name[run_file.name] = replace(
                run_file,
                laws=(*laws, *run_file.laws),
                given=(*given, *run_file.given),
                content=contents.get(run_file.sha256),
            )
    for name, text in () if kind else head.attachments.items():  # of older logs
        if name.endswith(".py") and not any(name in one.laws for one in files_by_name.values()):
            data = text.encode()
            digest = hashlib.sha256(data).hexdigest()
            files_by_name.setdefault(name, RunFile(name, "", digest, (name,), (), data))
    return list(files_by_name.values())


def _path_of(head: logs.Log, law: str, by_law: Mapping[str, Path]) -> Path | None:
    """Return the file of a law; None for one of the project's. LogError for what is neither."""
    module = law.partition(":")[0]
    if module in by_law:
        return by_law[module]
    module = present_name(module)
    is_path = module.endswith(".py") or "/" in module
    if not is_path and ("." not in module or module.startswith("pcpc.")):
        return None
    raise logs.LogError(
        f"{head.path}: its law {law} is neither the project's nor carried by the log; "
        "name another with --controller"
    )


# Which file it is


def _places(
    head: logs.Log, files: list[RunFile], folder: Path, trust: Trust
) -> dict[RunFile, Path]:
    """Return where each file is taken from; LogError if that needs the user's word."""
    beside = Path(trust.rig).resolve().parent if trust.rig else None
    named = _named_files(head, files, trust.law)
    places = {file: named.get(file) or _in_place(file, beside) for file in files}
    absent = [file for file, path in places.items() if path is None]
    if absent and trust.trust:
        lacking = [file.shown() for file in absent if file.content is None]
        if lacking:
            what = f"{', '.join(lacking)}: neither in the log nor unchanged in its old place"
            raise logs.LogError(f"{head.path}: {what}; name it with --law FILE")
    elif absent:
        raise logs.LogError(_refusal(head, absent))
    if all(path is not None and str(path) == file.path for file, path in places.items()):
        return {file: path for file, path in places.items() if path is not None}
    return {file: _placed_file(head, file, places[file], folder, files) for file in files}


def _refusal(head: logs.Log, absent: list[RunFile]) -> str:
    reasons = []
    for file in absent:
        there = bool(file.path) and os.path.lexists(file.path)
        state = "is another file now" if there else "is not there" if file.path else ""
        reasons.append(f"{file.shown()}" + (f", {file.path} {state}" if state else ""))
    return (
        f"{head.path}: was made with files from outside the project: {'; '.join(reasons)}"
        f"{packages_of(head)}; name their places with --law FILE or --rig RIG, or run "
        "the log's own copies, if you trust its author, with --trust"
    )


def _named_files(head: logs.Log, files: list[RunFile], law: Sequence[str]) -> dict[RunFile, Path]:
    """Return the files that --law names, by content, else by their names."""
    named: dict[RunFile, Path] = {}
    for text in law:
        path = Path(text).resolve()
        if not carried_files.is_ordinary(path):
            raise logs.LogError(f"--law {text}: no such file")
        digest = carried_files.sha256(path)
        same = [file for file in files if file.sha256 == digest]
        alike = same or [f for f in files if PurePosixPath(f.name).name == path.name]
        if not alike or (len(alike) > 1 and not same):
            known = ", ".join(file.name for file in files) or "none"
            which = "several files" if alike else "no file"
            raise logs.LogError(f"--law {text}: {head.path} has {which} of this name: {known}")
        named |= dict.fromkeys(alike, path)
    return named


def _in_place(file: RunFile, beside: Path | None) -> Path | None:
    """Return where a file lies with its recorded content; None if nowhere known."""
    places = [] if beside is None else [os.path.normpath(beside / file.name)]
    for text in (*places, file.path):
        path = Path(text)
        if text and "\0" not in text and path.is_absolute() and carried_files.is_ordinary(path):
            try:
                if carried_files.sha256(path) == file.sha256:
                    return path
            except OSError:
                continue
    return None


def _placed_file(
    head: logs.Log, file: RunFile, source: Path | None, folder: Path, files: list[RunFile]
) -> Path:
    """Put a file below `folder`, where it lay to the others; return its path."""
    ups = [posixpath.normpath(one.name).split("/").count("..") for one in files]
    base = folder / "files" / "/".join("d" * min(max(ups), MOST_UP)) / "rig"
    path = Path(posixpath.normpath(base / file.name))
    wrong = "\0" in file.name or posixpath.isabs(file.name)
    if wrong or not path.is_relative_to(folder / "files"):
        raise logs.LogError(f"{head.path}: attachment {file.name} lies too far from its rig")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if file.content is None and source is not None:
            path.symlink_to(source)
        else:
            path.write_bytes(file.content or b"" if source is None else source.read_bytes())
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise logs.LogError(f"{head.path}: attachment {file.name}: {reason}") from None
    if path.suffix == ".py" and str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # last: it hides nothing
    return path


# What laws open


def _redirections(files: list[RunFile], where: Mapping[RunFile, Path]) -> dict[str, str]:
    """Return what a law gets for the texts by which the run's laws opened files."""
    redirected: dict[str, str] = {}
    for file in files:
        redirected |= dict.fromkeys((file.path, *file.given), str(where[file]))
    redirected.pop("", None)
    return redirected


@contextmanager
def opened_from(places: Mapping[str, str]) -> Iterator[None]:
    """Let Python open, and find, the files `places` by other names."""

    def patched_function(function: Callable[..., Any]) -> Callable[..., Any]:
        def with_place(name: Any, *arguments: Any, **named: Any) -> Any:
            if isinstance(name, str | bytes | os.PathLike):
                text = os.fsdecode(name)
                name = places.get(text) or places.get(os.path.abspath(text)) or name
            return function(name, *arguments, **named)

        return with_place

    if not places:
        yield
        return
    openers: Any = vars(np.lib._datasource)["_file_openers"]  # loadtxt keeps `open` in here
    tables: list[tuple[dict[Any, Any], Any]] = [
        (vars(builtins), "open"), (vars(io), "open"), (vars(os), "open"), (vars(os), "stat"),
        (openers._file_openers, None),
    ]  # fmt: skip
    originals = [table[name] for table, name in tables]
    for table, name in tables:
        table[name] = patched_function(table[name])
    try:
        yield
    finally:
        for (table, name), original in zip(tables, originals, strict=True):
            table[name] = original
