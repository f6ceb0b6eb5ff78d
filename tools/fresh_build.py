"""The wheel holds what the source holds: setuptools' `build/lib` of an earlier build is removed."""

import shutil

from setuptools.command.build_py import build_py


class FreshBuild(build_py):
    """`build_py` into an empty folder; setuptools packs all that lies there, deleted files too."""

    def run(self) -> None:
        """Build."""
        if not self.editable_mode:
            shutil.rmtree(self.build_lib, ignore_errors=True)
        super().run()
