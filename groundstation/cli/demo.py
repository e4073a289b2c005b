"""``groundstation demo``: the whole story in one command."""

from __future__ import annotations

import signal
from itertools import chain, count
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import typer

from groundstation.cli.model_files import AS_JSON
from groundstation.cli.progress import own_terminal
from groundstation.cli.terminal import show_json
from groundstation.errors import GroundStationError

if TYPE_CHECKING:
    from groundstation.demo.story import Stage


def add_commands(app: typer.Typer) -> None:
    app.command("demo")(demo)


def demo(
    seed: int = typer.Option(1, min=0, max=10**6, help="Chooses what is hidden, and all noise."),
    output: Path | None = typer.Option(
        None,
        "-o",
        "--output",
        help="A new or empty folder (default: demo-SEED, demo-SEED-2 ...).",
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Show everything on the software craft: from a motor on the bench to a fault that is named.

    Measures a motor, fits a body, designs a controller and flies it; then something is hidden in
    the craft, the twin notices, the search names it, and the improved model flies like the craft.
    Takes three to seven minutes and leaves one report, with every file and command behind it.

    Example: [bold]groundstation demo --seed 3 -o story[/bold]
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from groundstation.demo.shell import Shell
    from groundstation.demo.story import STAGES, inputs, tell
    from groundstation.rerun_log.installed import require_rerun

    require_rerun("the story, which writes files for the viewer,")
    own_terminal()
    folder = output or _free_folder(f"demo-{seed}")
    console = Console(stderr=as_json, highlight=False, markup=False, soft_wrap=True)
    columns = (SpinnerColumn(), BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, _interrupt)
    with Shell(folder, inputs(seed), lambda line: console.print(f"  {line}")) as shell, bar:
        task = bar.add_task("", total=len(STAGES) + 1)

        def begin(number: int, stage: Stage) -> None:
            console.print(f"\n{number + 1}. {stage.title}")
            bar.update(task, completed=number, description=stage.title)

        told = tell(shell, seed, begin)
        bar.update(task, completed=len(STAGES), description="drawing the report")
        from groundstation.demo.outcome import judge
        from groundstation.demo.report import REPORT, report_page

        outcome = judge(shell.folder, seed, told)
        report_page(outcome).write(folder / REPORT)
        spent = shell.spent
    if as_json:
        whole = {
            **outcome.as_dict(),
            "seconds": round(spent.wall_s, 1),
            "report": str(folder / REPORT),
        }
        show_json(whole)
    else:
        console.print("\nThe seal is opened.")
        for reason in told.skipped.values():
            console.print(f"  the controller was {reason}")
        for claim in outcome.claims:
            console.print(f"  {'yes' if claim.true else 'NO '}  {claim.text}")
        console.print(f"\n{folder / REPORT}   ({spent.wall_s:.0f} s)")
    if not outcome.good:
        missed = ", ".join(claim.name for claim in outcome.claims if not claim.true)
        raise GroundStationError(f"not everything came true ({missed}): see {folder / REPORT}")


def _free_folder(name: str) -> Path:
    """The name, or the name with the first number that is free."""
    numbered = (Path(f"{name}-{number}") for number in count(2))
    return next(path for path in chain([Path(name)], numbered) if not path.exists())


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Whoever ends us ends what we run, in order."""
    raise KeyboardInterrupt
