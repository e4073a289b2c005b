"""The notebook in docs runs from its first cell to its last, and each result shows itself."""

import ast
import json

import pytest

from groundstation.report.page import Result
from support import ROOT

NOTEBOOK = ROOT / "docs" / "tour.ipynb"


@pytest.mark.timeout(900)
def test_the_notebook_runs_in_order_on_the_recordings_of_a_clone(monkeypatch):
    monkeypatch.chdir(ROOT)
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    names, shown = {}, []
    for cell in cells:
        if cell["cell_type"] == "code":
            assert not cell["outputs"]
            *before, last = ast.parse("".join(cell["source"])).body
            exec(compile(ast.Module(before, []), NOTEBOOK.name, "exec"), names)
            assert isinstance(last, ast.Expr), "a cell ends with what it shows"
            shown.append(eval(compile(ast.Expression(last.value), NOTEBOOK.name, "eval"), names))
    kinds = [type(one).__name__ for one in shown]
    figure = ["Figure"]
    assert kinds == ["Recording", *figure, "Identified", *figure * 2, "Discrepancy", *figure]
    for one in shown:
        if isinstance(one, Result):
            assert one._repr_html_().startswith("<div>")
