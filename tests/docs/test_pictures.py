"""Each example that can be looked at has a picture, which `make pictures` makes."""

import ast
import json
import re
from pathlib import Path

import pytest

from tests.docs.pages import PAGES, ROOT

pytest.importorskip("PIL", reason="needs PIL: pip install PIL")
pytest.importorskip("textual", reason="needs textual: pip install textual")

from docs import pictures

EXAMPLES = sorted((ROOT / "examples").glob("*.*"))
MADE = sorted(pictures.PICTURES)
# Taken by hand: Rerun's window is no page of a browser.
_BY_HAND = {"rerun"}


def first_lines(example: Path) -> str:
    """What an example says about itself."""
    if example.suffix == ".ipynb":
        return "".join(json.loads(example.read_text())["cells"][0]["source"])
    return ast.get_docstring(ast.parse(example.read_text())) or ""


def test_each_example_that_can_be_looked_at_has_a_picture() -> None:
    """Examples whose first lines name a view have, and the notebook, which draws its buffer."""
    shown = {
        example.stem
        for example in EXAMPLES
        if example.suffix == ".ipynb" or re.search(r"--view|`tfbus view", first_lines(example))
    }
    assert shown == {take.__name__ for take in pictures.OF_EXAMPLES}


def test_each_picture_is_made_by_the_command() -> None:
    """No image lies in docs/images that `make pictures` does not make, and none is missing."""
    images = {path.stem for path in pictures.IMAGES.iterdir() if path.suffix in (".png", ".svg")}
    assert images - _BY_HAND == set(MADE)


@pytest.mark.parametrize("name", MADE)
def test_each_picture_is_on_a_page_with_a_description(name: str) -> None:
    """Its alternative text is a sentence, for those who do not see it."""
    text = "".join(page.read_text() for page in PAGES)
    assert re.search(rf"!\[[A-Z][^\]]{{20,}}\.\]\([^)]*images/{name}\.(png|svg)\)", text)


def test_the_pictures_of_examples_are_small() -> None:
    """A page with all of them loads fast."""
    names = {take.__name__ for take in pictures.OF_EXAMPLES}
    sizes = [path.stat().st_size for path in pictures.IMAGES.iterdir() if path.stem in names]
    assert sum(sizes) < 600_000


def test_the_picture_of_the_notebook_is_what_it_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Made again, it is the same."""
    kept = (pictures.IMAGES / "buffer_notebook.svg").read_text()
    monkeypatch.setattr(pictures, "IMAGES", tmp_path)
    pictures.buffer_notebook()
    assert (tmp_path / "buffer_notebook.svg").read_text() == kept


def test_a_picture_that_does_not_exist_is_refused() -> None:
    """With the names of those that do."""
    with pytest.raises(SystemExit, match=r"picture tortoise: .*two_robots"):
        pictures.main(["tortoise"])


def test_what_a_picture_needs_is_said(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where its module is missing, the picture stays as it is."""
    monkeypatch.setitem(pictures.NEEDS, "mujoco_world", ("no_such_module", "a-package"))
    pictures.main(["mujoco_world"])
    said = capsys.readouterr().out
    assert "needs no_such_module" in said and "pip install a-package" in said
