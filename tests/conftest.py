"""Of all tests: what they import stays, so nothing in it is searched for garbage again and again."""

import gc

gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()
