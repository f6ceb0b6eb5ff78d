"""The state-variable table: one writer each, contiguous views, wiring by name and unit."""

import pytest

from pcpc.executive.errors import RigError
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage
from pcpc.executive.loop.table import Table, Variable, add_block


class Parameters(Ports):
    """A gain and weights."""

    kv = port("N m s/rad", "gain", 1.0, 0.0, 9.0)
    w = port("", "weights", shape=3)


class States(Ports):
    """What is recorded, and what is not."""

    s_Nm = port("N m", "integral")
    rng = port("", "noise", recorded=False)
    scratch = port("", "tmp", recorded=False)


class Inputs(Ports):
    """One and several."""

    angle_rad = port("rad", "measured")
    rates = port("rad/s", "of two gyros", shape=2)


class Outputs(Ports):
    """One."""

    torque_Nm = port("N m", "command")


@stage
def nothing(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Do nothing: a table never steps."""


BLOCK = Block(nothing)
PLACE = "rig.yaml:3:5"


def filled() -> Table:
    table = Table()
    table.add(Variable("time.t_s", "s", "health", "loop", "time"))
    add_block(table, "law", BLOCK)
    return table


def test_a_blocks_views_are_contiguous_disjoint_and_complete() -> None:
    table = Table()
    table.add(Variable("time.t_s", "s", "health", "loop", "time"))
    views = add_block(table, "law", BLOCK)
    ranges = (views.parameters, views.states, views.inputs, views.outputs)
    assert [len(r) for r in ranges] == [4, 3, 3, 1], ranges
    assert [i for r in ranges for i in r] == list(range(1, len(table.variables)))
    kinds = [{table.variables[i].kind for i in r} for r in ranges]
    assert kinds == [{"parameter"}, {"state"}, {"input"}, {"output"}], kinds


def test_elements_of_a_port_are_named_by_number() -> None:
    names = [v.name for v in filled().variables if v.name.startswith("law.w")]
    assert names == ["law.w_0", "law.w_1", "law.w_2"], names


def test_every_variable_has_name_unit_kind_writer_and_meaning() -> None:
    table = filled()
    for variable in table.variables:
        assert variable.name and variable.writer and variable.help, variable
        assert table.variables[table.index[variable.name]] is variable
    gain = table.variables[table.index["law.kv"]]
    assert (gain.unit, gain.low, gain.high) == ("N m s/rad", 0.0, 9.0), gain


def test_states_and_outputs_are_recorded_but_not_scratch_and_noise() -> None:
    recorded = [v.name for v in filled().variables if v.recorded]
    assert recorded == ["time.t_s", "law.s_Nm", "law.torque_Nm"], recorded


def test_settings_are_the_parameters_of_a_block_that_has_no_others() -> None:
    assert BLOCK.settings == BLOCK.parameters == Parameters.ports


def test_a_second_writer_of_a_variable_is_refused() -> None:
    table = filled()
    with pytest.raises(RigError, match=r"law\.kv: two writers: law and other"):
        table.add(Variable("law.kv", "", "output", "other", ""))


def test_two_ports_of_a_block_cannot_share_a_name() -> None:
    @stage
    def step(t: float, dt: float, p: Nothing, x: Nothing, u: Outputs, y: Outputs) -> None:
        """Do nothing."""

    with pytest.raises(RigError, match=r"law\.torque_Nm: two writers"):
        add_block(Table(), "law", Block(step))


@pytest.mark.parametrize("name", ["law.torque_Nm", "law.s_Nm", "law.kv", "time.t_s"])
def test_anything_with_the_right_unit_is_a_source(name: str) -> None:
    table = filled()
    unit = table.variables[table.index[name]].unit
    assert table.source(name, unit, PLACE, "law.angle_rad") == table.index[name]


def test_an_unknown_source_says_where_and_suggests() -> None:
    with pytest.raises(RigError) as caught:
        filled().source("law.torqe", "N m", PLACE, "law.angle_rad")
    expected = "law.angle_rad: no variable 'law.torqe'; did you mean law.torque_Nm?"
    assert str(caught.value) == f"{PLACE}: {expected}"


def test_an_input_is_never_suggested_as_a_source() -> None:
    with pytest.raises(RigError) as caught:
        filled().source("law.angle", "rad", PLACE, "x")
    assert "angle_rad?" not in str(caught.value), caught.value


def test_another_unit_says_both() -> None:
    with pytest.raises(RigError) as caught:
        filled().source("law.torque_Nm", "rad", PLACE, "law.angle_rad")
    expected = "law.angle_rad is in 'rad' but law.torque_Nm is in 'N m'"
    assert str(caught.value).startswith(f"{PLACE}: {expected}"), caught.value


def test_no_unit_is_shown_as_one() -> None:
    with pytest.raises(RigError, match=r"is in '1' but time\.t_s is in 's'"):
        filled().source("time.t_s", "", PLACE, "law.w_0")
