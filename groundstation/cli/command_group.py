"""Groups of commands whose options mean what was typed."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from groundstation import BadInputError
from groundstation.cli.progress import watched

FORMER = {
    "attitude --tune": "give Q and R by --noise; only their ratios matter",
    "config --reload": "a change takes effect with the next start of the daemon",
    "config --show": "'groundstation config' shows it",
    "export": "the header is groundstation/telemetry/groundstation_telemetry.h, also in a wheel",
    **dict.fromkeys(
        (
            f"bench motor {one}"
            for one in ("-o", "--output", "--html", "--with", "--motor", "--mass", "--vehicle")
        ),
        "'groundstation fit motor' fits the recording that is made",
    ),
    **dict.fromkeys(
        (f"fit {what} --rerun" for what in ("motor", "body", "arx")),
        "--html draws the same series",
    ),
    "inspect --thumbnail": "the page opens a recording with all its plots",
    "jobs": "jobs are begun and watched on the page ('groundstation page') and by the control API"
    " (POST /jobs/start, GET /jobs)",
    "models": "models are on the page ('groundstation page') and in the control API (GET /models);"
    " 'groundstation link stand-in:ID' flies one, POST /models/watch watches with one",
    "pid design --attitude": "the firmware's loops fly a model's body, --loop direct its"
    " polynomials",
    "pid design --rounding": "--sensitivity keeps margins, by more than printed digits leave open",
    "pid evaluate --attitude": "the firmware's loops fly a model's body, --loop direct and"
    " whole its polynomials",
    "recordings": "'groundstation inspect FOLDER' lists a folder of recordings",
    "pid evaluate --thesis": "'groundstation thesis' has the printed tables",
    "run --page-port": "give --set page.port=PORT",
    "run --viewer-port": "give --set viewer.port=PORT",
    "run --web-port": "give --set viewer.web_port=PORT",
    **dict.fromkeys(
        (
            f"{what} {one}"
            for what in ("compare", "discrepancy")
            for one in ("--stretch", "--marked")
        ),
        "the report shows the seconds in which the model is most wrong ('A closer look'); 'inspect'"
        " lists what the live model check marked",
    ),
    "simulate --html": "'groundstation compare --html' draws where a model and a flight disagree;"
    " in Python, simulate_run(...).plot() draws a replayed flight",
}
"""Commands and options of earlier versions, and what does their work now."""


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
        for word in args:
            option = word.partition("=")[0]
            _require_current(ctx, f"{ctx.command_path.partition(' ')[2]} {option}")
        _, _, given = self.make_parser(ctx).parse_args(args=list(args))
        for one in given:
            single = one.nargs == 1 and not getattr(one, "multiple", False)
            times = given.count(one)
            if single and not getattr(one, "is_flag", False) and times > 1:
                listed = "commas" in (getattr(one, "help", None) or "") or "," in str(one.metavar)
                several = ", several separated by commas" if listed else ""
                raise BadInputError(f"{one.opts[0]}: given {times} times; give it once{several}")
        return super().parse_args(ctx, args)


class Root(TyperGroup):
    """Of all commands: knows those that there were."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        _require_current(ctx, args[0])
        return super().resolve_command(ctx, args)


def _require_current(ctx: Any, words: str) -> None:
    """Raise a usage error for what there is no more."""
    if words in FORMER:
        raise typer.BadParameter(f"there is no '{words}' any more: {FORMER[words]}", ctx)
