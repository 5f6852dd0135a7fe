"""The notebooks of docs/notebooks: their cells run, their outputs are kept in them, and the site shows both.

python scripts/notebooks.py [NOTEBOOK...]    # runs them and writes their outputs
"""

import ast
import base64
import html
import io
import json
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = tuple(sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")))
Output = dict[str, Any]


def run(notebook: dict[str, Any]) -> dict[str, Any]:
    """Return the notebook with the outputs of its cells, run one after another in an empty folder beside examples."""
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = [cell | {"outputs": []} if cell["cell_type"] == "code" else cell for cell in notebook["cells"]]
    with tempfile.TemporaryDirectory() as folder, chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        Path("examples").symlink_to(ROOT / "examples")
        for number, cell in enumerate((cell for cell in cells if cell["cell_type"] == "code"), start=1):
            cell |= {"execution_count": number, "outputs": list(_outputs("".join(cell["source"]), names, number))}
    return notebook | {"cells": cells}


def _outputs(source: str, names: dict[str, Any], number: int) -> Iterator[Output]:
    """Run a cell as Jupyter does: what is printed, the value of the last expression, and open figures."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    tree, value, printed = ast.parse(source), None, io.StringIO()
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with redirect_stdout(printed):
        exec(compile(tree, f"cell {number}", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), names)
    if printed.getvalue():
        yield {"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(keepends=True)}
    if plt.get_fignums():
        png = io.BytesIO()
        plt.gcf().savefig(png, dpi=80, bbox_inches="tight", metadata={"Software": None})
        plt.close("all")
        data = {"image/png": base64.b64encode(png.getvalue()).decode()}
        yield {"output_type": "display_data", "metadata": {}, "data": data}
    elif value is not None:
        shown = {"text/plain": str(value).splitlines(keepends=True)}
        if hasattr(value, "_repr_html_"):
            shown["text/html"] = value._repr_html_().splitlines(keepends=True)
        yield {"output_type": "execute_result", "execution_count": number, "metadata": {}, "data": shown}


def as_markdown(text: str) -> str:
    """Return a notebook's JSON as the Markdown that the site shows."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        parts += [_shown(output) for output in cell.get("outputs", [])]
    return "\n\n".join(parts) + "\n"


def _shown(output: Output) -> str:
    """Return an output as Markdown."""
    data = output.get("data", {"text/plain": output.get("text", [])})
    if "image/png" in data:
        return f'```{{raw}} html\n<img alt="output of the cell" src="data:image/png;base64,{data["image/png"]}">\n```'
    if "text/html" in data:
        return f'```{{raw}} html\n<div class="output">{"".join(data["text/html"])}</div>\n```'
    return f'```{{raw}} html\n<pre class="output">{html.escape("".join(data["text/plain"]))}</pre>\n```'


def written(notebook: dict[str, Any]) -> str:
    return json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    for file in [Path(name).resolve() for name in sys.argv[1:]] or NOTEBOOKS:
        file.write_text(written(run(json.loads(file.read_text(encoding="utf-8")))), encoding="utf-8")
