"""Run a WebAssembly program with the wasmtime of Python: `python wasm.py PROGRAM`."""

import sys
from importlib import import_module


def main(program: str) -> int:
    """Run a program that prints to stdout; return its exit code."""
    wasmtime = import_module("wasmtime")
    store = wasmtime.Store(wasmtime.Engine())
    wasi = wasmtime.WasiConfig()
    wasi.inherit_stdout()
    store.set_wasi(wasi)
    linker = wasmtime.Linker(store.engine)
    linker.define_wasi()
    try:
        made = linker.instantiate(store, wasmtime.Module.from_file(store.engine, program))
        made.exports(store)["_start"](store)
    except wasmtime.ExitTrap as ended:
        return int(ended.code)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
