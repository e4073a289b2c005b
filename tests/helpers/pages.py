"""README and docs taken apart: fenced blocks, the commands in them, links, words in backticks."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
PROGRAMS = {
    *("groundstation", "make", "python", "pip", "source", "curl", "sudo", "modprobe", "usbip"),
    *("ssh", "sh", "pytest"),
}
"""What the first word of a command in a block can be."""
DATA = {"python", "toml", "json", "csv", "c", "text", "console"}
"""Languages of blocks that hold no commands; ``text`` behind commands is what they
print, ``console`` the same where no test repeats it."""


@dataclass(frozen=True)
class Block:
    """A fenced block: line is that of its first line of content, from 1."""

    page: Path
    line: int
    language: str
    text: str

    @property
    def where(self):
        return f"{self.page.name}:{self.line}"

    @property
    def holds_commands(self):
        """Marked ``sh``, or unmarked and beginning with a program."""
        words = self.text.split(maxsplit=1)
        return self.language == "sh" or (not self.language and bool(words) and words[0] in PROGRAMS)

    def commands(self):
        """The command lines, continued ones joined, without comments."""
        found = []
        joined = self.text.replace("\\\n", " ")
        for line in joined.splitlines():
            without = re.sub(r"(^|\s)#\s.*$", "", line).strip()
            if without:
                found.append(" ".join(without.split()))
        return found


def blocks_of(page):
    found, lines, start, language = [], [], None, ""
    for number, line in enumerate(page.read_text().splitlines(), 1):
        mark = re.match(r"\s*```(\w*)\s*$", line)
        if mark is None:
            if start is not None:
                lines.append(line)
        elif start is None:
            start, language, lines = number + 1, mark.group(1), []
        else:
            found.append(Block(page, start, language, "\n".join(lines) + "\n"))
            start = None
    assert start is None, f"{page.name}:{start}: a block that does not end"
    return found


def prose_of(page):
    """The page without its fenced blocks."""
    return re.sub(r"^\s*```.*?^\s*```\s*$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def inline_code(page):
    """What stands in backticks in the prose, line breaks made blanks."""
    return [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose_of(page))]


def links_of(page):
    """(target, anchor) of each relative link and image."""
    for target in re.findall(r"\]\(([^)\s]+)\)", prose_of(page)):
        if not re.match(r"\w+:", target):
            path, _, anchor = target.partition("#")
            yield path, anchor


def anchors_of(page):
    """The names under which headings can be linked, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", prose_of(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}
