"""Puts a fault into a module as it is imported; nothing on disk changes.

Python imports a module of this name at its start where the folder is on ``PYTHONPATH``, so what a
test starts has the fault too. ``GROUNDSTATION_MUTANT`` says which, as JSON: ``module``, ``path``,
``old`` and ``new`` text.
"""

import importlib.util
import json
import os
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import SourceFileLoader

VARIABLE = "GROUNDSTATION_MUTANT"


class _Loader(SourceFileLoader):
    def __init__(self, module: str, path: str, old: str, new: str) -> None:
        super().__init__(module, path)
        self._old, self._new = old.encode(), new.encode()

    def get_data(self, path):
        content = super().get_data(path)
        return content.replace(self._old, self._new) if path == self.path else content

    def get_code(self, fullname):
        """From the source: byte code on disk is that of the sound module."""
        return self.source_to_code(self.get_data(self.path), self.path)


class _Finder(MetaPathFinder):
    def __init__(self, fault: dict[str, str]) -> None:
        self._fault = fault

    def find_spec(self, fullname, path, target=None):
        if fullname != self._fault["module"]:
            return None
        loader = _Loader(**self._fault)
        return importlib.util.spec_from_file_location(fullname, loader.path, loader=loader)


if VARIABLE in os.environ:
    sys.meta_path.insert(0, _Finder(json.loads(os.environ[VARIABLE])))
