"""``groundstation jobs``: work on recordings that the running daemon does in the background."""

from __future__ import annotations

import typer

from groundstation.cli.command_group import Commands
from groundstation.cli.model_files import AS_JSON
from groundstation.cli.terminal import show, show_json
from groundstation.service.client import ask
from groundstation.service.config import socket_path

jobs = Commands(
    help=(
        "Fits, comparisons and searches that the running daemon does in the background."
        "\n\nExample: [bold]groundstation jobs list[/bold]"
    ),
    no_args_is_help=True,
)
NAME = typer.Argument(help="The job, as 'groundstation jobs list' names it.")


def add_commands(app: typer.Typer) -> None:
    app.add_typer(jobs, name="jobs")


@jobs.command("list")
def list_jobs(as_json: bool = AS_JSON) -> None:
    """Every job, the oldest first.

    Example: [bold]groundstation jobs list[/bold]
    """
    found = ask(socket_path(), "GET", "/jobs")
    if as_json:
        show_json(found)
        return
    for job in found:
        show(f"{job['id']:<38} {job['state']:<10} {' '.join(job['recordings'])}  {job['text']}")


@jobs.command("start")
def start(
    kind: str = typer.Argument(help="inspect, fit, compare, discrepancy or design."),
    recordings: list[str] = typer.Argument(
        None, help="Files of the recordings folder; none for a design."
    ),
    validate: list[str] = typer.Option([], help="A file that no fit sees; may be repeated."),
    model: str = typer.Option("", help="The id of a fit that is done, or thesis."),
    as_json: bool = AS_JSON,
) -> None:
    """Begin a job, or let it wait for its turn.

    Example: [bold]groundstation jobs start fit flight.mcap[/bold]
    """
    body = {"kind": kind, "recordings": recordings or [], "validate": validate, "model": model}
    job = ask(socket_path(), "POST", "/jobs/start", body)
    if as_json:
        show_json(job)
    else:
        show(job["id"])


@jobs.command("log")
def log(name: str = NAME, as_json: bool = AS_JSON) -> None:
    """The end of a job's log.

    Example: [bold]groundstation jobs log 2026-11-22T20-00-00-000Z_fit[/bold]
    """
    answer = ask(socket_path(), "POST", "/jobs/log", {"id": name})
    if as_json:
        show_json(answer)
        return
    for line in answer["text"].splitlines():
        show(line)


@jobs.command("cancel")
def cancel(name: str = NAME, as_json: bool = AS_JSON) -> None:
    """End a job that waits or runs.

    Example: [bold]groundstation jobs cancel 2026-11-22T20-00-00-000Z_fit[/bold]
    """
    job = ask(socket_path(), "POST", "/jobs/cancel", {"id": name})
    if as_json:
        show_json(job)
    else:
        show(f"{job['id']}  {job['state']}")
