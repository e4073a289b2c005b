"""Which Python files of effects may run: a model that names one is a program, not only data."""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from groundstation.documents import read_document
from groundstation.errors import BadInputError

CONSENT = "GROUNDSTATION_TRUST_EFFECTS"
"""``ALL`` or the SHA-256 of a file: what it names may run, and is known from then on."""
ALL = "1"
_SOURCE_MOST = 1 << 20


def trusted_source(path: Path) -> bytes:
    """The content of a Python file that may run: one whose SHA-256 is known, or with consent.

    Raises OSError where it cannot be read, BadInputError where nobody has consented.
    """
    content = read_document(path, _SOURCE_MOST)
    digest = _digest(content)
    if digest in _known():
        return content
    if os.environ.get(CONSENT, "") not in (ALL, digest):
        raise BadInputError(
            f"effect file {path} is a Python program that would run with your rights (SHA-256"
            f" {digest[:16]}..., not known here); read it, and if you trust it say so once with"
            " 'groundstation --trust-effects COMMAND ...'"
        )
    with contextlib.suppress(OSError):  # then it is asked again
        _known_path().parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with _known_path().open("a", encoding="utf-8") as file:
            file.write(f"{digest}  {path!s:.200}\n".replace("\n", " ").strip() + "\n")
    return content


def consent(path: Path | None = None) -> None:
    """Let this program, and those it starts, run the file that the user named; without one, all.

    Raises OSError where it cannot be read.
    """
    digest = ALL if path is None else _digest(read_document(path, _SOURCE_MOST))
    if os.environ.get(CONSENT) != ALL:
        os.environ[CONSENT] = digest


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _known() -> set[str]:
    try:
        lines = read_document(_known_path()).decode(errors="replace").splitlines()
    except OSError:
        return set()
    return {line.split(" ", 1)[0] for line in lines}


def _known_path() -> Path:
    folder = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(folder).expanduser() / "groundstation" / "trusted_effects"
