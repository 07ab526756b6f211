"""Runs the notebooks of docs/notebooks when the site is built, and shows each as a page with its output.

As in Jupyter, a semicolon at the end of a cell drops the value of its last line.

The notebooks are kept without output. They need no Jupyter here: a cell is run as it stands, what it prints, the value of
its last line and the figures that are open after it go below it. A cell that raises ends the build.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib

FOLDER = Path(__file__).parents[1] / "notebooks"


class Page(NamedTuple):
    """A notebook as Markdown, and its figures by file name."""

    text: str
    figures: dict[str, bytes]


def run(path: Path) -> Page:
    """Run a notebook from its first cell to its last."""
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    values: dict[str, Any] = {"__name__": "__main__"}
    parts = [f"*The page of a notebook, run when the site was built: [{path.name}]({path.name}).*"]
    figures: dict[str, bytes] = {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        if printed := output(source, values, path.name):
            parts.append(f"```text\n{printed}\n```")
        for number in plt.get_fignums():
            buffer = io.BytesIO()
            plt.figure(number).savefig(buffer, format="png", dpi=100, facecolor="white", bbox_inches="tight")
            name = f"{path.stem}-{len(figures) + 1}.png"
            figures[name] = buffer.getvalue()
            parts.append(f"![Figure {len(figures)} of the notebook]({name})")
        plt.close("all")
    title, first = parts[1], parts[0]
    return Page("\n\n".join([title, first, *parts[2:]]) + "\n", figures)


def output(source: str, values: dict[str, Any], name: str) -> str:
    """What a cell prints, and the value of its last line if that is an expression."""
    tree = ast.parse(source, filename=name)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, name, "exec"), values)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), name, "eval"), values)
            if value is not None and not source.rstrip().endswith(";"):
                print(repr(value))
    return printed.getvalue().rstrip()


def on_files(files: Any, config: Any) -> Any:
    """Add the pages and their figures to the site."""
    from mkdocs.structure.files import File

    for path in sorted(FOLDER.glob("*.ipynb")):
        page = run(path)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=page.text))
        for name, content in page.figures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files
