"""`live.plot`: what moves in a notebook is what the run recorded, and it ends with it."""

from collections.abc import Iterator
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from processes import own_bus

import pcpc
from pcpc.tools.api.live_plot import LivePlot, follow

LONG = {  # and no stall of a busy machine ends it
    "duration_s": 600.0, "supervisor.hold_cycles": 10**6, "supervisor.fault_after_cycles": 10**6,
}  # fmt: skip
CELL = """
import pcpc
with pcpc.running("slew10", pacing="real", bus={bus!r}, set={long!r}) as live:
    last = live.plot("controller.e_rad", "plant:barrel.theta_rad", window_s=1.0, for_s=0.5)
    print(live.running, last)
"""


class Watched(NotebookClient):
    """A notebook whose pictures are kept as they come."""

    def __init__(self, *words: Any, **named: Any) -> None:
        super().__init__(*words, **named)
        self.pictures = list[str]()

    def process_message(self, message: Any, cell: Any, place: int) -> Any:
        """Keep what is displayed, for the first time and again."""
        if message["msg_type"] in ("display_data", "update_display_data"):
            self.pictures.append(message["content"]["data"]["image/png"])
        return super().process_message(message, cell, place)


def test_a_cell_shows_a_moving_plot_of_a_real_run() -> None:
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(CELL.format(bus=own_bus(), long=LONG))]
    )
    client = Watched(notebook, timeout=600)
    client.execute()
    picture, text = notebook.cells[0].outputs
    assert len(set(client.pictures)) >= 2, f"{len(client.pictures)} pictures"
    assert picture.data["image/png"] == client.pictures[-1]  # one place, the last picture in it
    assert text["text"] == "True Figure()\n", text


@pytest.fixture(scope="module")
def live() -> Iterator[pcpc.Live]:
    with pcpc.running("slew10", pacing="real", bus=own_bus(), set=LONG) as made:
        yield made


def test_an_interrupt_ends_the_plot_and_not_the_run(live: pcpc.Live) -> None:
    pictures = []

    def show(picture: pcpc.Figure) -> None:
        pictures.append(picture)
        if len(pictures) == 3:
            raise KeyboardInterrupt

    moving = LivePlot([("e", *live._split("controller.e_rad"))], 1.0)
    last = follow(moving, lambda: live.running, 0.05, show)
    assert len(pictures) == 4 and pictures[-1] is last and live.running


def test_the_lines_are_the_cycles_that_the_log_has(live: pcpc.Live) -> None:
    begin = live.cycle
    names = ("controller.e_rad", "plant:barrel.theta_rad", "controller.motor_torque_Nm")
    moving = LivePlot([(name, *live._split(name)) for name in names], 0.3)
    follow(moving, lambda: live.cycle < begin + 400, 0.05, lambda picture: None)
    assert [len(ax.get_lines()) for ax in moving._axes] == [2, 1]  # by unit
    lines = {name: line.get_xydata() for name, line in moving._lines.items()}
    run = live.stop()
    for name, line in lines.items():
        node, _, variable = name.rpartition(":")
        own = run.log.node[node or "executive"]
        drawn = np.round(1e3 * line[:, 0])
        rows = np.flatnonzero((own.cycle > drawn[-1] - 300) & (own.cycle <= drawn[-1]))
        assert drawn[-1] >= begin + 400 and np.array_equal(own.cycle[rows], drawn), name
        assert np.array_equal(own.columns[variable][rows], line[:, 1]), name


def test_what_cannot_be_plotted_is_a_line_and_a_plot_ends_with_its_run() -> None:
    with pcpc.running("slew10", pacing="real", bus=own_bus(), set=LONG) as live:
        with pytest.raises(pcpc.UnknownName, match="no such variable; did you mean"):
            live.plot("controller.e_radd")
        with pytest.raises(pcpc.UnknownName, match="kv_Nms_rad: not recorded, so it cannot be"):
            live.plot("controller.kv_Nms_rad")
        with pytest.raises(pcpc.Error, match=r"^window_s=0: expected more than 0$"):
            live.plot("controller.e_rad", window_s=0.0)
        live._command.ask()
        assert live.plot("controller.e_rad").png.startswith(b"\x89PNG")
        assert not live.running
