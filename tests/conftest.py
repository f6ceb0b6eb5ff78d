"""Of all tests: what they import stays, and is not searched for garbage again and again."""

import gc

gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()
