"""Compile all laws and plants that are imported somewhere: once, so that no two workers do it."""

import importlib
import pkgutil

import pcpc.executive.laws
import pcpc.plants

for package in (pcpc.executive.laws, pcpc.plants):
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if "study" not in found.name:
            importlib.import_module(found.name)
