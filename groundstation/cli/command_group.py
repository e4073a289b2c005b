"""Groups of commands whose options mean what was typed."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperCommand

from groundstation.cli.progress import watched
from groundstation.errors import BadInputError


class Commands(typer.Typer):
    """A group of commands; an option that holds one value may be given once."""

    def command(self, *names: Any, **more: Any) -> Any:
        """As typer's; of an option given twice, typer's own commands take the last in silence."""
        return super().command(*names, **{"cls": _Command, **more})


class _Command(TyperCommand):
    def invoke(self, ctx: Any) -> Any:
        with watched():
            return super().invoke(ctx)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        _, _, given = self.make_parser(ctx).parse_args(args=list(args))
        for one in given:
            single = one.nargs == 1 and not getattr(one, "multiple", False)
            times = given.count(one)
            if single and not getattr(one, "is_flag", False) and times > 1:
                listed = "commas" in (getattr(one, "help", None) or "") or "," in str(one.metavar)
                several = ", several separated by commas" if listed else ""
                raise BadInputError(f"{one.opts[0]}: given {times} times; give it once{several}")
        return super().parse_args(ctx, args)
