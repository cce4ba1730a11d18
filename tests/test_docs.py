"""Pages of reference equal the models that they are made from."""

import importlib
import importlib.util
import re
from pathlib import Path

import pytest

from angler_mjx.learning.datasets import index, manifest
from angler_mjx.scenario import reference

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("kind", ["scenario", "vehicle"])
def test_the_reference_is_that_of_the_models(kind):
    page = (ROOT / "docs" / f"reference_{kind}.md").read_text(encoding="utf-8")
    assert page == reference.format_page(kind)
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) > 40
    assert not [row for row in rows if row.endswith("|  |")]  # every key has a meaning


def test_the_reference_has_every_key_of_the_shipped_files():
    for kind, folder in (
        ("scenario", ROOT / "angler_mjx" / "scenario" / "shipped"),
        ("vehicle", ROOT / "angler_mjx" / "robot" / "vehicles" / "data"),
    ):
        page = reference.format_page(kind)
        for path in folder.rglob("*.toml"):
            for key in re.findall(r"^([a-z_0-9]+) = ", path.read_text(), re.M):
                assert f"| `{key}` |" in page, f"{path.name}: {key}"


def test_every_field_of_a_dataset_is_documented():
    """With the unit and meaning that the index has in its own metadata."""
    text = (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8")
    fields = text.partition("## Fields")[2].partition("\n## ")[0]
    documented, columns = fields.split("`index.parquet`", 1)
    rows = re.findall(r"^\| (`.*?) \|", documented, re.M)
    names = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(names) == sorted(manifest.Manifest.model_fields)
    for model in (manifest.PartEntry, manifest.ArrayEntry):
        for name in model.model_fields:
            assert f"`{name}`" in documented, name
    found = re.findall(r"^\| `(\w+)` \| (.*?) ?\| (.*) \|$", columns, re.M)
    wanted = []
    for field in index.SCHEMA:
        unit, meaning = (field.metadata[key].decode() for key in (b"unit", b"description"))
        wanted.append((field.name, unit.replace("1", ""), meaning))
    assert found == wanted


def _imports():
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        for found in re.finditer(r"^\s*(?:>>> )?from (angler_[\w.]+) import ([\w, ]+)", text, re.M):
            for name in found[2].split(","):
                yield pytest.param(
                    found[1], name.split(" as ")[0].strip(), id=f"{page.name}: {found[1]} {name}"
                )


@pytest.mark.filterwarnings("error::DeprecationWarning")
@pytest.mark.parametrize(("module", "name"), _imports())
def test_a_printed_import_leads_to_what_is_there_today(module, name):
    if module.endswith("torch"):
        pytest.importorskip("torch")
    home = importlib.import_module(module)
    assert hasattr(home, name) or importlib.util.find_spec(f"{module}.{name}")
