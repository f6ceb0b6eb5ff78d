"""Logged signals as a table: `law: table, file: run.mcap, signal: controller.e_rad`.

`plant:motor.angle_rad` is one of the plant, as is `motor.angle_rad`: see `executive.log.names`. The
column is called as the variable, without its block. Times are k T of the cycles.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.names import find_variable, unknown_name
from pcpc.executive.rig.tables import MOST_VALUES, Numbers, table_reader
from pcpc.executive.rig.yamlfile import display_path


@table_reader(".mcap")
def signals(file: Path, names: Sequence[str]) -> Numbers:
    """Return what a log recorded of variables of one node; RigError."""
    where = display_path(file)
    log = logs.read(file)
    if log.missing:
        cure = "name a complete log, or a CSV file with the part to use"
        raise RigError(f"{where}: {log.missing[0]}; {cure}")
    split = [find_variable(log, name) or name.rpartition(":")[::2] for name in names]
    roles = list(dict.fromkeys(role or "executive" for role, _ in split))
    if len(roles) != 1 or roles[0] not in log.node:
        problem = "signals of one node are needed" if len(roles) > 1 else f"no node {roles[0]}"
        raise RigError(f"{where}: {problem}; it has {', '.join(log.node)}")
    node = log.node[roles[0]]
    units = {name: unit for name, unit, *_ in node.description["variables"]}
    for given, (_, name) in zip(names, split, strict=True):
        if name not in node.columns:
            raise RigError(f"{where}: {unknown_name(log, given)}")
    period_ns = float(log.metadata[roles[0]]["period_ns"])
    columns = [f"{name.rpartition('.')[2]} [{units[name]}]" for _, name in split]
    values = np.column_stack([node.columns[name] for _, name in split])
    if len(values) < 2 or not np.isfinite(values).all():
        raise RigError(f"{where}: {', '.join(names)}: two records, all finite, are needed")
    if values.size > MOST_VALUES:
        problem = f"{values.size} values, a table holds {MOST_VALUES}"
        raise RigError(f"{where}: {problem}; take a shorter run or fewer signals")
    times_s = node.cycle.astype(np.float64) * (period_ns * 1e-9)
    return Numbers(columns, times_s, values)
