"""Of all tests: what they import stays, and is not searched for garbage again and again.

The files that take longest come first, so that in the end no processor waits for one of them.
"""

import gc

import pytest

LONGEST = [  # in turn
    "test_pytest_plugin", "test_pages", "test_ci", "test_neural_controllers", "test_memory",
    "test_virtual", "test_stalls", "test_cluster", "test_logs_damage", "test_run", "test_replay",
    "test_compare_versions", "test_supervisor_model", "test_every_rig", "test_hostile_logs",
    "test_golden", "test_mutants", "test_hangs", "test_kills", "test_kept_code", "test_api",
    "test_bench_suites", "test_monitors", "test_jitter", "test_soak", "test_play", "test_trial",
    "test_campaign", "test_verdict", "test_check", "test_outside", "test_judge", "test_ending",
    "test_wrong_input", "test_wheel",
]  # fmt: skip

gc.disable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; the others stay in their order."""
    order = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()
