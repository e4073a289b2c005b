"""Whether rerun is there: an extra, for it is larger than all the rest."""

from __future__ import annotations

import importlib.util

from groundstation.errors import BadInputError, install


def require_rerun(what: str) -> None:
    """Raises BadInputError, which names the extra to install, where rerun is missing.

    what: what needs it, as the sentence's subject.
    """
    if importlib.util.find_spec("rerun") is None:
        raise BadInputError(
            f"{what} needs rerun, an optional part of some 500 MB: {install('viewer')}"
        )
