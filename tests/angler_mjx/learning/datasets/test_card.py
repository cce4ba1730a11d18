"""The card: its head is what hubs of datasets read, its loader line loads."""

import re

import pytest
import yaml

from angler_mjx.learning import datasets
from angler_mjx.learning.datasets import card, parts
from angler_mjx.learning.datasets.manifest import read_manifest
from angler_mjx.shipped import find_shipped


def read_head(lines):
    begin, end = (i for i, line in enumerate(lines) if line == "---")
    assert begin == 0
    return yaml.safe_load("\n".join(lines[1:end]))


def test_the_head_is_yaml_with_a_licence_of_the_hub_and_a_preview_that_exists(made):
    head = read_head((made / "README.md").read_text().splitlines())
    assert head["license"] == "cc-by-4.0"
    assert head["pretty_name"] == "small"
    ((preview,),) = [config["data_files"] for config in head["configs"]]
    assert (made / preview["path"]).is_file()


@pytest.mark.parametrize(
    ("episodes", "size"),
    [
        (1, "n<1K"),
        (999, "n<1K"),
        (1000, "1K<n<10K"),
        (99_999, "10K<n<100K"),
        (100_000, "100K<n<1M"),
        (10**6, "1M<n<10M"),
    ],
)
def test_the_head_says_how_large_it_is(made, episodes, size):
    manifest = read_manifest(made).model_copy(update={"episodes": episodes})
    assert read_head(card._format_hub_fields(manifest))["size_categories"] == [size]


def test_the_loader_line_of_the_card_loads(made):
    text = (made / "README.md").read_text()
    code = re.search(r"```python\n(.*?)```", text, re.S)[1].replace("PATH", str(made))
    variables = {}
    exec(code, variables)
    assert len(variables["train"]) == len(datasets.open(made, split="train"))


def read_shipped(name):
    return parts.read_config(find_shipped(name, "angler_mjx.learning.datasets", "dataset file"))


def test_the_public_dataset_is_that_of_reef_with_rock_of_its_own():
    public, table = read_shipped("angler_reef_100k")
    reef, table_of_reef = read_shipped("reef")
    other = ("name", "description", "seed")
    assert public.model_dump(exclude=set(other)) == reef.model_dump(exclude=set(other))
    assert table == table_of_reef
    assert all(getattr(public, key) != getattr(reef, key) for key in other)
    made = parts.build_parts(public, table, 100_000, "angler_reef_100k")
    assert sum(part.scenario.worlds for part in made) == 100_000
    sample = parts.build_parts(public, table, 18_000, "angler_reef_100k")
    assert [part.scenario.seed for part in sample] == [part.scenario.seed for part in made]
    seeds = {part.scenario.seed for part in made}
    assert len(seeds) == len(made)
    assert not seeds & {
        part.scenario.seed for part in parts.build_parts(reef, table, 100_000, "reef")
    }
