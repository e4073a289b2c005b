"""A fault: one text of one source file replaced by another, and the tests that must notice."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Fault:
    """What is put in.

    name: unique, in kebab case. breaks: what goes wrong for whoever uses the program.
    file: relative to the repository. old: occurs exactly once there. new: what replaces it.
    tests: files or node ids of the short suite. least: how many of their tests must fail.
    """

    name: str
    breaks: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    least: int = 1

    @property
    def path(self) -> Path:
        return ROOT / self.file

    @cached_property
    def is_compiled(self) -> bool:
        """Whether kernels are made of this file: then what is cached of them must not be used."""
        text = self.path.read_text()
        return ".compiled import" in text or self.path.parent.name == "effects"

    def untrue(self) -> str:
        """Where the table and the sources differ, in words; empty where they do not."""
        if not self.path.is_file():
            return f"{self.name}: {self.file} is not there any more; say where it is now"
        count = self.path.read_text().count(self.old)
        if count != 1:
            return (
                f"{self.name}: the text to be replaced occurs {count} times in {self.file} and must"
                f" occur once; bring the table of bench/mutants up to date: {self.old!r}"
            )
        for test in self.tests:
            file, *within = test.partition("[")[0].split("::")
            text = (ROOT / file).read_text() if (ROOT / file).is_file() else None
            if text is None or not all(f" {one}(" in text for one in within):
                return f"{self.name}: there is no test {test} any more; name one that should notice"
        return ""

    def as_variable(self) -> str:
        """What ``GROUNDSTATION_MUTANT`` holds."""
        module = self.file.removesuffix(".py").replace("/", ".")
        fault = {"module": module, "path": str(self.path), "old": self.old, "new": self.new}
        return json.dumps(fault)
