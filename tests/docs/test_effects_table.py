"""The table of effects in docs/discrepancy.md is the one that the files make."""

from pages import ROOT

from groundstation.discrepancy.findings import Reason
from groundstation.dynamics.registry import EFFECTS

PAGE = ROOT / "docs" / "discrepancy.md"


def table():
    """Its lines."""
    lines = ["| effect | adds | fly | confused with |", "|---|---|---|---|"]
    for one in EFFECTS.values():
        others = ", ".join(f"`{other.other}`" for other in one.confused_with)
        cells = (f"`{one.name}`", one.adds.replace("|", "/"), one.excited_by, others)
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def test_the_table_of_effects_is_made_from_their_files():
    page = PAGE.read_text(encoding="utf-8")
    made = "\n".join(table())
    assert made in page, f"put this into {PAGE.name}:\n{made}"


def parameters():
    """The lines of the table in docs/simulate.md: stage, and each parameter's default and range."""
    lines = ["| effect | stage | parameters: default (plausible range) |", "|---|---|---|"]
    for one in EFFECTS.values():
        cells = (
            f"`{p.name}` {p.default:g} ({p.low:g}..{p.high:g}) {p.unit}".rstrip()
            for p in one.parameters
        )
        lines.append(f"| `{one.name}` | {one.stage} | {'; '.join(cells)} |")
    return lines


def test_the_table_of_parameters_is_made_from_the_effects_files():
    page = (ROOT / "docs" / "simulate.md").read_text(encoding="utf-8")
    made = "\n".join(parameters())
    assert made in page, f"put this into simulate.md:\n{made}"


def test_every_reason_of_a_refusal_is_on_the_page():
    page = PAGE.read_text(encoding="utf-8")
    assert [reason for reason in Reason if f"`{reason.value}`" not in page] == []
