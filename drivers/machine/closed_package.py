"""Parts of a package without the rest of it, which its __init__ would import as well.

After `leave_closed("cantools")`, `import cantools.database` runs only the files of that part. Who
asks the package for anything else opens it: its __init__ is run then.
"""

import sys
from importlib.util import find_spec, module_from_spec
from typing import Any


def leave_closed(package: str) -> None:
    """Let parts of a package be imported by themselves from now on; of an open one nothing."""
    if package in sys.modules or (spec := find_spec(package)) is None or spec.loader is None:
        return
    module, loader = module_from_spec(spec), spec.loader

    def opened(name: str) -> Any:
        if name.startswith("__") and name != "__version__":
            raise AttributeError(f"module {package} has no attribute {name}")
        if vars(module).pop("__getattr__", None) is not None:
            loader.exec_module(module)
        return getattr(module, name)

    module.__getattr__ = opened  # type: ignore[method-assign]
    sys.modules[package] = module
