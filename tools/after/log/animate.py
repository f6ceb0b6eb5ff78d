"""`pcpc log plot --moving`: the plant as it moved, a GIF painted from its scenes."""

from pathlib import Path

import numpy as np

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.plants.drawing import DrawingError, load, settings_of_log
from pcpc.plants.judging import Judged
from pcpc.plants.scene import Scene
from pcpc.tools.after.log import series
from pcpc.tools.after.log.commands import PlotRequest
from pcpc.tools.after.log.recorded import log_of
from pcpc.tools.after.opened import opened
from pcpc.tools.after.trust import Trust
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.outfile import LogCommandError, new_file
from pcpc.tools.terminal.progress import Progress

PER_S, WIDE_IN, DPI = 20, 6.4, 100
COLOURS = 256  # fewer lose those of small shapes
MOST = 2400  # pictures


def command(request: PlotRequest) -> int:
    """Paint the film; return the exit code. LogCommandError: wrong input."""
    progress = Progress(request.quiet)
    if len(request.words) != 1:
        raise LogCommandError(f"{' '.join(request.words)}: --moving takes one log, no variables")
    if request.output.suffix.lower() != ".gif":
        raise LogCommandError(f"{request.output}: expected a name that ends in .gif")
    need("a film needs", FIGURE, "PIL")
    log = series.read_log(log_of(request.words[0]), progress)
    window_s = series.window_s(request.window)
    if not request.speed > 0.0:
        raise LogCommandError(f"--speed {request.speed:g}: expected more than 0")
    times, scenes = _scenes(log, window_s, request, progress)
    with new_file(request.output, force=True) as path:
        _paint(times, scenes, path, progress)
    progress.close()
    print(f"{request.output}: {len(scenes)} pictures, {times[0]:g} to {times[-1]:g} s")
    return Exit.LOSS if log.missing else Exit.OK


def _scenes(
    log: logs.Log, window_s: tuple[float, float], request: PlotRequest, progress: Progress
) -> tuple[list[float], list[Scene]]:
    """Return the times and scenes of a log, PER_S for a second of the film."""
    leader = next(iter(log.node))
    run = Judged(log, 1e-9 * float(log.metadata[leader].get("period_ns", 1e9))).run(leader)
    inside = np.flatnonzero((run.t_s >= window_s[0]) & (run.t_s <= window_s[1]))
    if not len(inside):
        raise LogCommandError(f"{log.path}: no cycle between --start and --end")
    first, last = run.t_s[inside[0]], run.t_s[inside[-1]]
    count = int((last - first) * PER_S / request.speed + 1e-9) + 1
    if count > MOST:
        what = f"{count} pictures, more than {MOST}; take a part with --start and --end"
        raise LogCommandError(f"{log.path}: {what}, or a higher --speed")
    rows = np.searchsorted(run.t_s, first + np.arange(count) * request.speed / PER_S - 1e-9)
    with opened(log, Trust.of(request.code)) as opener:
        try:
            file, note = opener.drawing()
            if file is None:
                raise LogCommandError(f"{log.path}: its plant has no drawing.py")
            if note:
                progress.say(f"{log.path}: {note}")
            made, p = load(file), settings_of_log(log)
            columns = made.columns(run)
            scenes = [made.scene({k: v[row] for k, v in columns.items()}, p) for row in rows]
        except (logs.LogError, DrawingError) as error:
            raise LogCommandError(str(error)) from None
    return [float(run.t_s[row]) for row in rows], scenes


def _paint(times: list[float], scenes: list[Scene], path: Path, progress: Progress) -> None:
    """Write a GIF that goes round and round."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    x0, y0, x1, y1 = scenes[0].bounds
    canvas = FigureCanvasAgg(Figure((WIDE_IN, WIDE_IN * (y1 - y0) / (x1 - x0)), DPI))
    axes = canvas.figure.add_axes((0.0, 0.0, 1.0, 1.0))
    pictures = []
    for number, (t, scene) in enumerate(zip(times, scenes, strict=True), 1):
        progress.show(f"painting {number} of {len(scenes)}")
        axes.clear()
        scene.paint(axes)
        axes.text(x0, y0, f" {t:.2f} s", fontsize=8, va="bottom")
        canvas.draw()
        drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        pictures.append(drawn.quantize(COLOURS, dither=Image.Dither.NONE))
    first, *rest = pictures
    first.save(path, save_all=True, append_images=rest, duration=1000 // PER_S, loop=0)
