"""What the pages name exists: links, images, commands, options, targets, paths."""

import re
import shlex

import pytest
import typer

from groundstation.cli.app import app
from support import ROOT
from support.pages import DATA, PAGES, anchors_of, blocks_of, inline_code, links_of, prose_of

COMMANDS = typer.main.get_command(app)
TARGETS = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
BESIDE = {"ARGS", "GROUNDSTATION_LOCAL_DATA"}


def by_page(pages=PAGES):
    return pytest.mark.parametrize("page", pages, ids=lambda page: page.name)


def command_of(words):
    """(the command that the words begin with, its name); None where they name none."""
    found, names = COMMANDS, []
    for word in words:
        if word not in getattr(found, "commands", ()):
            break
        found = found.commands[word]
        names.append(word)
    return (found, " ".join(names)) if names else None


def options_of(command):
    return {name for option in command.params for name in (*option.opts, *option.secondary_opts)}


@by_page()
def test_every_link_leads_somewhere(page):
    for target, anchor in links_of(page):
        other = (page.parent / target).resolve() if target else page
        if other.parent == ROOT / "docs" / "reference":
            continue  # made with the site, where ``make docs`` asks the same of its links
        assert other.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors_of(other), f"{page.name}: {target}#{anchor}"


def test_every_picture_is_shown_and_every_page_linked():
    shown = {
        (page.parent / target).resolve() for page in PAGES for target, _ in links_of(page) if target
    }
    pictures = set((ROOT / "docs" / "images").iterdir())
    assert pictures <= shown
    assert set(PAGES) - {ROOT / "README.md", ROOT / "docs" / "index.md"} <= shown


@by_page()
def test_every_block_says_what_it_is(page):
    for block in blocks_of(page):
        drawing = "──" in block.text or block.text.startswith(("  ", "    "))
        known = block.language in DATA or block.holds_commands or drawing or _is_bytes(block.text)
        assert known, f"{block.where}: mark it ```sh, or with its language"


def _is_bytes(text):
    return re.fullmatch(r"([0-9a-f]{2}\s+)+", text) is not None


@by_page()
def test_every_command_and_option_in_the_prose_exists(page):
    for code in inline_code(page):
        if code.startswith("groundstation "):
            require_existing(code, page)
        elif code.startswith("make "):
            for word in shlex.split(code)[1:]:
                name = word.partition("=")[0]
                assert name in (BESIDE if "=" in word else TARGETS), f"{page.name}: {code}"
        elif code.startswith("python -m bench "):
            for name in code.split()[3:]:
                assert (ROOT / "bench" / f"{name}.py").is_file(), f"{page.name}: {code}"
        elif re.match(r"(tests|bench|groundstation|firmware_sim|docs|recordings)/\S*$", code):
            assert (ROOT / code).exists(), f"{page.name}: {code}"


def require_existing(code, page):
    words = [word.strip("[]") for word in code.split()]
    found = command_of(words[1:])
    if words[1].isupper() or words[1].startswith("--"):
        return
    assert found is not None, f"{page.name}: {code}"
    command, name = found
    for word in words[1:]:
        if word.startswith("-") and word != "-":
            option = word.split("=")[0]
            assert option in options_of(command), f"{page.name}: {name} has no {option}"


@by_page()
def test_every_option_named_alone_exists_somewhere(page):
    known = {"--version", "--help", "--trust-effects"}
    for command in every_command(COMMANDS):
        known |= options_of(command)
    source = "\n".join(
        (ROOT / path).read_text()
        for path in ("firmware_sim/__main__.py", "bench/sealed/__main__.py", "bench/soak.py")
    )
    for code in inline_code(page):
        if re.match(r"--?[a-z]", code):
            option = code.split()[0].split("=")[0]
            assert option in known or f'"{option}"' in source, f"{page.name}: {code}"


def every_command(command):
    if hasattr(command, "commands"):
        for one in command.commands.values():
            yield from every_command(one)
    else:
        yield command


def groups(command):
    if hasattr(command, "commands"):
        yield command
        for one in command.commands.values():
            yield from groups(one)


def test_every_help_has_an_example_whose_options_exist():
    lost = []
    for command in [*every_command(COMMANDS), *groups(COMMANDS)]:
        examples = re.findall(r"\[bold\](.*?)\[/bold\]", command.help or "", re.DOTALL)
        if not examples:
            lost.append(command.name)
        for example in examples:
            words = " ".join(example.split()).partition("|")[0].split()
            assert words[0] == "groundstation", example
            found, _ = command_of(words[1:])
            for word in words:
                assert not word.startswith("-") or word in options_of(found), (example, word)
    assert not lost, f"without an example: {lost}"


def test_every_option_and_argument_is_explained():
    for command in every_command(COMMANDS):
        for parameter in command.params:
            if parameter.name != "help":
                assert parameter.help, f"{command.name}: {parameter.name}"


DOCS = [page for page in PAGES if page.parent.name == "docs"]


@by_page(DOCS)
def test_no_line_is_too_long_to_be_read(page):
    """But tables and pictures, which cannot be broken."""
    lines = page.read_text().splitlines()
    assert [one for one in lines if len(one) > 120 and not one.startswith(("|", "!["))] == []


@by_page(DOCS)
def test_dates_commits_and_seeds_belong_to_the_evidence(page):
    if page.stem == "evidence":
        return
    months = "January|February|March|April|June|July|August|September|October|November|December"
    commit = r"(?=[0-9a-f]*[a-f])(?=[0-9a-f]*\d)[0-9a-f]{7}"
    story = rf"\b(?:\d{{1,2}} (?:{months})|{commit}|seeds? \d+)\b"
    assert re.findall(story, re.sub(r"`[^`]*`", "", prose_of(page))) == []


def test_the_glossary_has_at_most_25_words():
    rows = re.findall(r"^\| (?!word )", (ROOT / "docs" / "glossary.md").read_text(), re.MULTILINE)
    assert len(rows) <= 25
