"""Every command printed in the pages is executed; getting_started and the README's tour in order.

Each one runs in a folder of its own that holds the recordings of a clone and whatever files the
command names (``tests/support/pages.py``). What differs from what is printed:

- a command that goes on until Ctrl-C gets its Ctrl-C when it is up (``LIVE``); ``--for`` is 1 s
- ports are replaced by free ones, and paths under /tmp by ones in the folder
- ``SHORTER`` are options added to what would take minutes
- what the story or the tour carries out is not carried out again, whatever it is told to write
- what needs root, another machine or an hour is listed in ``ELSEWHERE``, with the file that runs it

A command that fits nowhere fails here: add what it needs.
"""

import os
import pty
import re
import shlex
import signal
import subprocess
import sys
from itertools import pairwise

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from firmware_sim import __main__ as stand_in
from groundstation.cli.app import app
from groundstation.cli.devices import usb_devices
from groundstation.errors import GroundStationError
from groundstation.service.config import UsbConfig
from support import ROOT
from support.daemons import COMMAND, Daemon
from support.pages import PAGES, blocks_of
from support.programs import Program, free_port, on_free_ports, run_program
from support.waiting import PATIENCE_S, until

SEALED = "tests/discrepancy/test_sealed.py"
FLEET = "tests/fleet/test_fleet.py"
ELSEWHERE = {
    # begins with: (why not here, where, what is to be found there)
    "make test-usb": ("a virtual machine of five minutes", ".ci/run", "make test-usb"),
    "make test": ("these tests are part of it", ".ci/run", "make test"),
    "make bench-discrepancy": ("hours", SEALED, "bench.sealed"),
    "python -m bench.sealed run": ("some searches; a slice of them", SEALED, "bench.sealed"),
    "python -m bench.sealed make": ("clean flights and their fit, too", SEALED, "bench.sealed"),
    "python -m bench.sealed table": ("needs the searches before it", SEALED, "bench.sealed"),
    "make bench": ("minutes; each part by itself", "bench/__main__.py", "rows()"),
    "make soak": ("a quarter of an hour", "bench/soak.py", "--hours"),
    "make check-local": ("recordings that are not published", "Makefile", "pytest tests/local"),
    "make demo": ("three minutes", ".ci/run", "make -s demo"),
    "groundstation learn": ("minutes", "tests/learn/test_learn.py", '"learn"'),
    "groundstation pid fly --rehearse": (
        *("flies a model for a minute", "tests/system/test_rehearsal.py", '"--rehearse"'),
    ),
    "groundstation plan": ("flies a model for 90 s", "tests/learn/test_plan.py", '"plan"'),
    "groundstation bench motor": (
        *("a craft on the bench", "tests/system/test_bench_motor.py", '"bench", "motor"'),
    ),
    "groundstation page": ("a daemon with a page", "tests/page/test_browser.py", '"page"'),
    "groundstation motors": ("a craft to command", "tests/system/test_pid_fly.py", 'told("stop")'),
    "sh learnt/commands.sh": ("after it", "tests/test_shell.py", "can_be_run_again"),
    # one axis and one search are in the story
    "groundstation pid design": ("10 s", "tests/cli/test_pid.py", '"design"'),
    "groundstation discrepancy": ("10 s", "tests/discrepancy/test_commands.py", "--validate"),
    "pip install -e '.[radio]'": ("the test environment has it", "Makefile", "dev,radio"),
    "pip install -e '.[fleet]'": ("the test environment has it", "Makefile", ",fleet]"),
    "groundstation fleet index": ("a fleet is flown once", FLEET, '"index"'),
    "groundstation fleet fit": ("a fleet is flown once", FLEET, '"fit"'),
    "groundstation fleet report": ("a fleet is flown once", FLEET, '"report"'),
    "python -m bench.fleet_flights": ("a fleet is flown once", FLEET, "fleet_flights.__file__"),
    "sudo udevadm control --reload": ("changes the machine", "tests/links/test_usb_rule.py", ""),
    "ssh ": ("another machine", "tests/viewer/test_viewer.py", "serve"),
}
SHORTER = {
    "groundstation pid design": ["--draws", "50"],
    "groundstation pid fly": ["--dry-run"],  # flown by tests/system/test_pid_fly.py
}
LIVE = ("groundstation run", "groundstation status --watch")
CLIENTS = (
    *("groundstation status", "groundstation events", "groundstation record ", "curl "),
    *("groundstation link", "groundstation pid fly"),
)
STEPS_OF_A_DOUBLET = 3
OF_THE_TEST = {"state", "control.sock", "control.lock", "control.page", "stdout", "stderr"}
STORY = ROOT / "docs" / "getting_started.md"


def printed(pages):
    """Each command once, with the pages that print it."""
    found = {}
    for page in pages:
        for block in blocks_of(page):
            if block.holds_commands:
                for command in block.commands():
                    found.setdefault(command, []).append(block.where)
    return found


(TOUR,) = (
    block
    for block in blocks_of(ROOT / "README.md")
    if block.holds_commands and "recordings/nanobench" in block.text
)
TOLD = {*printed([STORY]), *TOUR.commands()}
COMMANDS = printed(page for page in PAGES if page != STORY)


def elsewhere(command):
    return next((told for start, told in ELSEWHERE.items() if command.startswith(start)), None)


HERE = [command for command in COMMANDS if elsewhere(command) is None and command not in TOLD]


def each(commands):
    """By its first words: an id must stay the same where pages change."""
    return pytest.mark.parametrize("command", list(commands), ids=lambda command: command[:90])


@each(c for c in HERE if not c.startswith(CLIENTS))
def test_what_is_printed_works(command, folder, larder):
    for name in inputs_of(shlex.split(command)):
        larder.give(name, folder)
    carry_out(command, folder)


@each(c for c in COMMANDS if elsewhere(c) is not None)
def test_what_is_not_run_here_is_run_elsewhere(command):
    _, path, sign = elsewhere(command)
    place = ROOT / path
    assert place.exists(), path
    files = [place] if place.is_file() else sorted(place.glob("*.py"))
    assert any(sign in file.read_text() for file in files)
    if command.startswith("make "):
        assert_target(command)
    if command.startswith("groundstation "):
        assert_taken(command)


def assert_taken(command):
    """The command's options and their values are understood; nothing is run."""
    words = shlex.split(command, comments=True)[1:]
    taker = get_command(app)
    context = taker.make_context("groundstation", list(words))
    while hasattr(taker, "get_command"):
        name, *words = words
        taker = taker.get_command(context, name)
        assert taker is not None, name
    taker.make_context(name, words, parent=context)


@pytest.mark.timeout(900)  # half a minute where nothing else runs
def test_the_story_of_getting_started_goes_as_printed(folder, larder, with_station):
    """Its commands in order in one folder; a ``text`` block is what the commands before it say."""
    said, clone, there = "", folder, set(folder.iterdir())
    for block in blocks_of(STORY):
        if block.language == "toml":
            (folder / "flight.toml").write_text(block.text)
        elif block.language == "text":
            require_said(block, said)
            said = ""
        elif block.language == "console":
            require_planned(block, said)
        elif block.holds_commands:
            for command in block.commands():
                if command.startswith(CLIENTS):
                    with with_station():
                        said += carry_out(command, folder) or ""
                    continue
                if command.startswith("cd "):
                    folder /= command.removeprefix("cd ")
                    os.chdir(folder)
                    continue
                if command == "groundstation inspect sessions":
                    assert ".mcap" in carry_out(command, folder)
                    continue
                if work_of(command) not in TOURED:
                    said += carry_out(command, folder) or ""
    overlooked = (ROOT / ".gitignore").read_text().split()
    left = {one.name for one in set(clone.iterdir()) - there if one.name not in OF_THE_TEST}
    assert folder.name in left
    assert {f"/{name}/" for name in left} <= set(overlooked)


@pytest.mark.timeout(900)
def test_the_tour_of_the_readme_runs_as_it_stands(folder):
    """On what a clone has, in order."""
    told = {work_of(command): carry_out(command, folder) for command in TOUR.commands()}
    (search,) = (said for words, said in told.items() if words[1] == "discrepancy")
    require_no_channel_silently_worse(search)


def require_said(block, said):
    """Each line of the block is one that was said, in that order, numbers nearly."""
    lines = iter(said.splitlines())
    for expected in block.text.splitlines():
        assert any(alike(expected, line) for line in lines), f"{block.where}: {expected}\n{said}"


def require_no_channel_silently_worse(told):
    """Of the search on a real flight: its gaps on the flight held out."""
    gap = re.search(r"^gap over all channels: ([\d.]+), after ([\d.]+)", told, re.MULTILINE)
    assert float(gap[2]) < float(gap[1])
    channels = re.findall(r"^  (\S+) +([\d.]+) +([\d.]+) +\S+ .*, noise ", told, re.MULTILINE)
    assert len(channels) == 9
    for name, before, after in channels:
        worse = float(after) > 1.1 * float(before)  # less than a tenth is within noise
        assert not worse or f"worse on {name} on proof samples" in told


def require_planned(block, said):
    """The page's flight has as many steps as the programme that was shown and not flown here."""
    doublets = re.search(r"(\d+) doublets an axis", said)
    steps = re.search(r"^yaw +(\d+) ", block.text, re.MULTILINE)
    assert int(steps[1]) == STEPS_OF_A_DOUBLET * int(doublets[1])


def alike(expected, line):
    """The words are the same as far as the expected line goes; numbers within 5 %, standard
    errors within 30 %."""
    wanted, said = expected.split(), line.split()
    if len(said) < len(wanted):
        return False
    shares = [0.3 if before == "+-" else 0.05 for before in ("", *wanted)]
    return all(map(same, wanted, said, shares))


def same(expected, word, share):
    expected, word = expected.rstrip(","), word.rstrip(",")
    if word == expected:
        return True
    try:
        one, other = float(expected), float(word)
    except ValueError:
        return False
    return abs(one - other) <= share * abs(one)


def test_a_printed_number_that_is_off_is_noticed():
    assert alike("  c0   0.00434358 +- 1.1e-05", "  c0   0.00434 +- 1.12e-05")
    assert not alike("  c0   0.00434358 +- 1.1e-05", "  c0   0.00400 +- 1.1e-05")
    assert not alike("1 effect found", "2 effects found")


# the last one: the daemon flies until the end of the module
@each(c for c in HERE if c.startswith(CLIENTS))
def test_what_is_printed_for_a_running_daemon_works(command, folder, larder, station):
    for name in inputs_of(shlex.split(command)):
        larder.give(name, folder)
    carry_out(command, folder)


def assert_target(command):
    shown = run_program(["make", "-n", *shlex.split(command)[1:]], cwd=ROOT)
    assert shown.returncode == 0, shown.stderr


def carry_out(command, folder):
    """Run one command as the rules above say; what it printed."""
    command = command.replace("/tmp/", f"{folder}/").partition(" | sudo ")[0]
    for port in re.findall(r"127\.0\.0\.1:(\d+)", command):
        command = command.replace(port, str(free_port()))
    words = shlex.split(command)
    for start, more in SHORTER.items():
        if command.startswith(start):
            words += more
    if command.startswith("make run"):
        return make_run(folder)
    if command.startswith(LIVE):
        return live(words, folder)
    if command == "groundstation link usb":
        return another_link(words)
    if words[0] == "groundstation":
        return in_process(words[1:])
    if words[:3] == ["python", "-m", "firmware_sim"]:
        return fly(words[3:], folder)
    return in_shell(command)


def outputs_of(words):
    """What a command is to write: it must not be there before."""
    written = [after for word, after in pairwise(words) if word in OUTPUTS]
    if "--dry-run" in words:
        return []
    if words[:2] == ["groundstation", "convert"]:
        written.append([word for word in words[2:] if not word.startswith("-")][1])
    if words[:2] == ["groundstation", "discrepancy"] and "--json" in words:
        written.append(words[words.index("--json") + 1])
    return written


OUTPUTS = ("-o", "--output", "--html", "--rerun")


def work_of(command):
    """A command without what it is told to write: the words that decide how long it takes."""
    words = shlex.split(command, comments=True)
    return tuple(word for word in words if word not in (*OUTPUTS, *outputs_of(words)))


TOURED = {work_of(command) for command in TOUR.commands() if "nanobench" in command}
"""Fits and searches on real flights, which end the story too."""


def inputs_of(words):
    return [word.removeprefix("replay:") for word in words if word not in outputs_of(words)]


def in_process(words):
    """A command to its end, with the interpreter that is running: starting one takes a second."""
    result = CliRunner().invoke(app, words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    for path in outputs_of(["groundstation", *words]):
        assert os.path.getsize(path), path
    return result.stdout


def another_link(words):
    """To USB and back where a bridge is plugged in; else the refusal says that none is."""
    if any(row["usable"] for row in usb_devices(UsbConfig().device)[0]):
        return in_process(words[1:]) + in_process(["link", "stand-in"])
    with pytest.raises(GroundStationError, match="is plugged in"):
        in_process(words[1:])
    return ""


def in_shell(command):
    done = run_program(
        ["bash", "-c", f"set -o pipefail; {command}"],
        timeout=PATIENCE_S,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def fly(words, folder):
    """``python -m firmware_sim``: in fast time to its end, else until Ctrl-C."""
    if "--fast" in words:
        assert stand_in.main(words) == 0
        assert os.path.getsize(outputs_of(words)[0])
        return ""
    with Program(
        [sys.executable, "-u", "-m", "firmware_sim", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        said = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        said += process.communicate(timeout=PATIENCE_S)[0]
    assert process.returncode in (0, 130), said
    return said


def live(words, folder):
    """``run`` until its link streams, or waits for what is not plugged in; then Ctrl-C."""
    if words[1] == "status":
        return watch(words)
    if "serve" in words:
        words += on_free_ports("viewer.port", "viewer.web_port")
    if "--page" in words:
        words += on_free_ports("page.port")
    ends = "--for" in words
    if ends:
        words[words.index("--for") + 1] = "1"
    hardware = any(word.startswith(("usb", "serial:", "radio://")) for word in words)
    with Daemon(folder, *words[2:], socket_path=folder / "control.sock") as daemon:
        if ends:
            assert daemon.wait() == 0, daemon.stderr
        else:
            up = {"streaming"} | ({"opening", "silent"} if hardware else set())
            daemon.status_when(lambda status: status["link"]["state"] in up, "the link")
            if not hardware:
                daemon.recording()
            assert daemon.stop() == 0, daemon.stderr
        assert hardware or daemon.files()
        return daemon.stdout + daemon.stderr


def watch(words):
    """On a terminal, as ``--watch`` is meant for, until it shows something; deaf to Ctrl-C, as
    in the background of a script."""
    outer, inner = pty.openpty()
    deaf = ["sh", "-c", 'trap "" INT; exec "$@"', "sh"]
    with Program([*deaf, COMMAND, *words[1:]], stdout=inner, stderr=subprocess.PIPE) as process:
        os.close(inner)
        said = b""
        while b"link" not in said:
            said += os.read(outer, 4096)
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)
        _, error = process.communicate(timeout=PATIENCE_S)
    os.close(outer)
    assert (process.returncode, error) == (143, b"groundstation: terminated\n")
    return said.decode(errors="ignore")  # what was read may end within a character


def make_run(folder):
    """``make run`` from the Makefile, as it is; nothing is installed again."""
    environment = os.path.dirname(os.path.dirname(sys.executable))
    ports = " ".join(on_free_ports("viewer.port", "viewer.web_port", "page.port"))
    done = run_program(
        [
            *("make", f"VENV={environment}", "-o", f"{environment}/.ready", "run"),
            f"ARGS=--for 2 --recordings {folder / 'sessions'} {ports}",
        ],
        cwd=ROOT,
        env={**os.environ, "GROUNDSTATION_SOCKET": str(folder / "control.sock")},
        stderr=subprocess.STDOUT,
        timeout=PATIENCE_S,
        check=True,
    )
    (recording,) = (folder / "sessions").glob("*.mcap")
    until(lambda: recording.stat().st_size, "a recording")
    return done.stdout
