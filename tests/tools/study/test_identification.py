"""`pcpc experiment identification`: its identifier is the rig's, and its counts are right."""

import numpy as np

from pcpc.plants.telerobot.book import identified_network as network
from pcpc.tools.study.fit.book import _identified_seeds as seeds


def test_the_identifier_beside_the_loop_learns_what_the_one_in_the_loop_learns():
    q, v, known, _f, period_s, log = network.recorded("duration_s=3.0")
    followed = network.tuned(
        q, v, known, network.features(q, v), period_s, lambda w, st: network.KAP * w
    )[1]
    own = log.node["local"].columns
    learned = np.stack([own[f"servo.network_{j}_rad_s2"] for j in (1, 2)], axis=1)[: len(q)]
    different = np.sqrt(np.mean((followed[: len(learned)] - learned) ** 2, axis=0))
    assert (different < 0.005 * learned.std(axis=0)).all(), f"{different} of {learned.std(axis=0)}"


def test_an_interval_that_misses_is_counted_and_told():
    true = seeds.true_values()
    half = 0.01 * true
    found = [seeds.SeedFit(n, true + 0.5 * half, true, half, 200) for n in range(94)]
    off = np.array([2.0, *np.zeros(len(true) - 1)])
    found += [seeds.SeedFit(n, true + off * half, true, half, 200) for n in range(94, 100)]
    table, missed = seeds.table(found)
    rows = {row.split("|")[1].strip(): row.split("|") for row in table.splitlines() if "`b" in row}
    assert rows["`barrel.coulomb_Nm`"][9].strip() == "94"
    assert rows["`barrel.gap_rad`"][9].strip() == "100"
    assert missed == ["barrel.coulomb_Nm: the true value is inside of 94 of 100 intervals"]
