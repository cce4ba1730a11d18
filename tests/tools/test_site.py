"""The site: its menu, the links of staged pages, the check of what was built, API, versions."""

import json
import re
from pathlib import Path

import pytest
from docutils import nodes
from docutils.core import publish_doctree

import angler_mjx
from tools.site import __main__ as site
from tools.site import api, examples, gallery, menu, notebook_pages, staging, tables
from tools.site.checking import check_site

ROOT = Path(__file__).parents[2]


@pytest.fixture
def docs(tmp_path):
    folder = tmp_path / "docs"
    (folder / "how_to").mkdir(parents=True)
    (folder / "how_to" / "fly.md").write_text("# Fly\n\nThis page flies. It lands: see below.\n")
    (folder / "how_to" / "stay.md").write_text("# Stay\n\n    code\n\nA sentence.\n")
    (folder / "README.md").write_text(
        "# Documentation\n\n## How-to\n\n"
        "- **Move**: [x](how_to/fly.md), [the\n  other](how_to/stay.md)\n\n"
        "## Project\n\n- **Work**: [changes](../CHANGES.md)\n"
    )
    (tmp_path / "CHANGES.md").write_text("# Changes\n")
    return folder


def test_a_heading_is_a_section_a_bold_word_a_group_a_link_a_page(docs):
    how_to, project = menu.read_menu(docs)
    assert (how_to.title, how_to.slug) == ("How-to", "how_to")
    assert [(group.title, [page.stem for page in group.pages]) for group in how_to.groups] == [
        ("Move", ["fly", "stay"])
    ]
    assert [page.name for page in project.groups[0].pages] == ["CHANGES.md"]


def test_a_link_to_a_folder_stands_for_its_pages(docs):
    readme = docs / "README.md"
    text = readme.read_text()
    readme.write_text(re.sub(r"\[x\].*\n.*\n", "[all](how_to/)\n", text))
    assert [page.stem for page in menu.read_menu(docs)[0].groups[0].pages] == ["fly", "stay"]


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda text: text.replace("[x](how_to/fly.md), ", ""), "no menu reaches how_to/fly.md"),
        (lambda text: text.replace("fly.md", "fled.md"), "how_to/fled.md: no such page"),
        (lambda text: text.replace("stay.md", "fly.md"), "listed twice: fly.md"),
    ],
    ids=["no menu", "no page", "twice"],
)
def test_a_menu_and_pages_that_do_not_agree_are_refused(docs, change, fault):
    readme = docs / "README.md"
    readme.write_text(change(readme.read_text()))
    with pytest.raises(menu.MenuError, match=re.escape(fault)):
        menu.read_menu(docs)


def test_every_page_of_the_documentation_is_in_the_menu():
    menu.read_menu(ROOT / "docs")


def test_the_summary_is_the_first_sentence_of_a_page_that_begins_with_one(docs):
    assert staging.read_summary(docs / "how_to" / "fly.md") == "This page flies."
    assert staging.read_summary(docs / "how_to" / "stay.md") == ""


def test_links_lead_to_where_their_files_are_staged(tmp_path):
    (tmp_path / "docs" / "how_to").mkdir(parents=True)
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "a.toml").write_text("a = 1")
    for name in ("README.md", "CONTRIBUTING.md", "docs/README.md"):
        (tmp_path / name).write_text(f"# {name}\n")
    page = tmp_path / "docs" / "how_to" / "fly.md"
    page.write_text(
        "# Fly\n\n[a](../../README.md#install) [`b`](../../CONTRIBUTING.md)\n"
        "[c](../../code/a.toml) [d](https://e.f/g) ![h](../i.png) `[j](k)`\n"
        "```text\n[l](m)\n```\n[n](#fly)\n"
    )
    (tmp_path / "docs" / "i.png").write_bytes(b"")
    pages = {
        tmp_path / "README.md": "index.md",
        tmp_path / "CONTRIBUTING.md": "project/contributing.md",
        page: "how_to/fly.md",
    }
    target = tmp_path / "target"
    staged = staging.rewrite_links(page, "how_to/fly.md", staging.Stage(tmp_path, target, pages))
    assert staged == (
        "# Fly\n\n[a](../index.md#install) [`b`](../project/contributing.md)\n"
        "[c](../files/code/a.toml) [d](https://e.f/g) ![h](../i.png) `[j](k)`\n"
        "```text\n[l](m)\n```\n[n](#fly)\n"
    )
    assert (target / "files" / "code" / "a.toml").read_text() == "a = 1"


def test_a_link_to_nothing_is_refused(tmp_path):
    page = tmp_path / "docs" / "fly.md"
    page.parent.mkdir()
    page.write_text("# Fly\n\n[a](gone.md)\n")
    stage = staging.Stage(tmp_path, tmp_path / "target", {page: "fly.md"})
    with pytest.raises(menu.MenuError, match=r"docs/fly\.md: gone\.md: no such file"):
        staging.rewrite_links(page, "fly.md", stage)


def test_all_sources_are_staged(tmp_path):
    staging.stage_site(tmp_path / "source", None)
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").as_posix()
        assert (tmp_path / "source" / name.replace("README.md", "all_pages.md")).is_file(), name
    listed = (tmp_path / "source" / "gallery.md").read_text()
    assert listed.count(":img-top:") == len(gallery.list_figures(ROOT / "docs")) > 30


def _site(folder, **pages):
    menu_text = "".join(f'<a href="{name}.html">x</a>' for name in pages if name != "hidden")
    for name, body in {"index": "", **pages}.items():
        (folder / f"{name}.html").write_text(
            f'<html><nav>{menu_text}</nav><h1 id="top">x</h1>{body}</html>'
        )
    (folder / "a.png").write_bytes(b"")
    return check_site(folder)


def test_a_site_without_faults_has_none(tmp_path):
    body = (
        '<a href="index.html#top">x</a><a href="#top">x</a><a href="https://x.y">x</a>'
        '<img src="a.png" alt="a"><img src="data:image/png;base64,AA" alt="b">'
    )
    assert _site(tmp_path, page=body) == []


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ('<a href="gone.html">x</a>', "page.html: gone.html: no such file"),
        ('<a href="index.html#gone">x</a>', "page.html: index.html#gone: no such anchor"),
        ('<a href="#gone">x</a>', "page.html: #gone: no such anchor"),
        ('<img src="gone.png" alt="a">', "page.html: gone.png: no such file"),
        ('<video src="gone.mp4"></video>', "page.html: gone.mp4: no such file"),
        ('<img src="a.png">', "page.html: a.png: a picture without a text"),
        ('<script src="https://x.y/z.js"></script>', "https://x.y/z.js: loaded from outside"),
        ('<link rel="stylesheet" href="//x.y/z.css">', "//x.y/z.css: loaded from outside"),
        ('<a href="file:///x">x</a>', "file:///x: unknown scheme"),
        ("<pre>a ([<b>x</b>](y/z.md#q))</pre>", "shown as it stands, as in a block of code"),
    ],
)
def test_a_fault_of_a_page_is_found(tmp_path, body, fault):
    (found,) = _site(tmp_path, page=body)
    assert found.endswith(fault)


def test_a_page_that_only_text_links_to_is_found(tmp_path):
    faults = _site(tmp_path, page='<a href="hidden.html">x</a>', hidden="")
    assert faults == ["no menu reaches hidden.html"]


def test_a_style_sheet_that_loads_from_outside_is_found(tmp_path):
    (tmp_path / "a.css").write_text("@font-face { src: url('https://x.y/z.woff2') }")
    assert _site(tmp_path) == ["a.css: loads from outside (https:)"]


def test_every_public_name_stands_on_one_page_of_the_api():
    names = [name for page in api.read_pages() for name in page.names]
    assert len(set(names)) == len(names)
    public = {f"angler_mjx.{name}" for name in angler_mjx.__all__}
    assert public <= set(names)
    for name in names:
        assert api.resolve_name(name).__doc__, name


def test_numbers_of_the_first_page_are_those_of_the_readme():
    """Or of the page of speed; `test_claims.py` and the commands beside them prove them."""
    landing = (staging.THEME / "landing.md").read_text(encoding="utf-8")
    pages = ("README.md", "docs/explanation/performance.md")
    text = " ".join((ROOT / page).read_text(encoding="utf-8") for page in pages)
    readme = " ".join(text.split())
    numbers = re.findall(r"<strong>(.+?)</strong>", landing)
    assert len(numbers) >= 4
    assert [number for number in numbers if number not in readme] == []


def test_versions_are_listed_with_the_newest_first(tmp_path):
    for name in ("0.2.0", "0.10.0", "main"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "index.html").write_text("")
    site.list_versions(tmp_path)
    listed = (tmp_path / site.VERSIONS).read_text()
    assert json.loads(re.search(r"\[.*\]", listed)[0]) == ["0.10.0", "0.2.0", "main"]
    assert 'href="0.10.0/index.html"' in (tmp_path / "index.html").read_text()


def test_the_text_of_an_example_is_its_docstring_or_its_first_comment(tmp_path):
    (tmp_path / "a.py").write_text('"""Fly. It is\nquick.\n\nMore."""\n')
    assert examples.read_description(tmp_path / "a.py") == ("Fly", "It is quick.\n\nMore.")
    (tmp_path / "a.cpp").write_text("// Shortest paths: of all.\n// Build: cc\n\nint main;\n")
    assert examples.read_description(tmp_path / "a.cpp") == ("Shortest paths", "Of all. Build: cc")


def test_pages_that_an_example_names_are_links(tmp_path):
    folder, target = tmp_path / "examples", tmp_path / "source"
    folder.mkdir()
    target.mkdir()
    (folder / "a.py").write_text('"""Fly.\n\nTasks (docs/reference/tasks.md).\n"""\n')
    examples.write_pages(folder, target)
    text = (target / "examples.md").read_text()
    assert "Tasks ([reference/tasks.md](reference/tasks.md))." in text


def test_a_changelog_has_versions_without_brackets_and_none_without_text():
    changes = "# Changes\n\n## [Unreleased]\n\n## [1.0] - 2026-11-29\n\n- [x](y.md)\n"
    assert staging.format_changes(changes) == "# Changes\n\n## 1.0 - 2026-11-29\n\n- [x](y.md)\n"
    new = changes.replace("[Unreleased]\n", "[Unreleased]\n\n- z\n")
    assert "## Unreleased\n\n- z\n" in staging.format_changes(new)


def test_cells_of_tables_are_marked_by_the_length_of_their_texts():
    long = "a cell of more than sixty characters, which has to keep some width"
    page = publish_doctree(
        f".. list-table::\n\n   * - short\n     - {long}\n     - {long[:40]}\n",
        settings_overrides={"report_level": 5},
    )
    tables.mark_cells(None, page)
    cells = list(page.findall(nodes.entry))
    assert [cell["classes"] for cell in cells] == [[], ["long"], ["middling"]]


def test_code_with_a_word_wider_than_a_phone_is_marked():
    page = publish_doctree("``--out DIR`` ``tests/angler_mjx/studies/test_running.py``")
    tables.mark_words(None, page)
    assert [code["classes"] for code in page.findall(nodes.literal)] == [[], ["breaks"]]


def test_cells_of_notebooks_are_shown_in_their_language(tmp_path):
    sources = {
        "%%bash\nangler --help": "````bash\nangler --help\n````",
        "%%writefile a.toml\nx = 1": "````toml\n# a.toml\nx = 1\n````",
        "%%writefile a.urdf\n<a/>": "`a.urdf`:\n\n````xml\n<a/>\n````",
        "try:\n    %pip install a": "````ipython3\ntry:",
        "print(1)": "````python\nprint(1)\n````",
    }
    cell = {"cell_type": "code", "execution_count": 1, "outputs": []}
    notebook = tmp_path / "fly.ipynb"
    notebook.write_text(json.dumps({"cells": [{**cell, "source": text} for text in sources]}))
    page = notebook_pages.format_page(notebook)
    assert [text for text in sources.values() if text not in page] == []


@pytest.mark.parametrize("owner", ["OWNER/REPOSITORY", "a/b"])
def test_a_badge_is_a_link_on_a_page(tmp_path, owner):
    """A page loads no picture from elsewhere; before the owner is named there is no link either."""
    address = f"https://colab.research.google.com/github/{owner}/blob/main/docs/notebooks/fly.ipynb"
    badge = f"[![Open in Colab](https://colab.research.google.com/badge.svg)]({address})"
    notebook = tmp_path / "fly.ipynb"
    cell = {"cell_type": "markdown", "source": f"# Fly\n\n{badge}\n\nThis flies."}
    notebook.write_text(json.dumps({"cells": [cell]}))
    text = notebook_pages.format_page(notebook)
    assert text.startswith("# Fly\n\nThis flies.\n")
    assert "badge.svg" not in text
    assert (f"[Open it in Colab]({address})" in text) == (owner == "a/b")


def test_a_notebook_is_a_page_with_its_outputs(tmp_path):
    picture = {"output_type": "display_data", "data": {"image/png": "aGk=", "text/plain": "x"}}
    stream = {"output_type": "stream", "name": "stdout", "text": ["8 robots\n", "done\n"]}
    code = {"cell_type": "code", "execution_count": 1, "outputs": [stream, picture]}
    cells = [
        {"cell_type": "markdown", "source": ["# Fly\n", "\n", "This flies."]},
        {**code, "source": ["%%writefile a.cpp\n", "int a;"]},
    ]
    notebook = tmp_path / "fly.ipynb"
    notebook.write_text(json.dumps({"cells": cells}))
    text = notebook_pages.format_page(notebook)
    assert text.startswith("# Fly\n\nThis flies.\n")
    assert "````cpp\n// a.cpp\nint a;\n````" in text
    assert "````text\n8 robots\ndone\n````" in text
    assert "(fly_0.png)" in text
    assert notebook_pages.list_pictures(notebook) == {"fly_0.png": b"hi"}
    cells[1]["execution_count"] = None
    notebook.write_text(json.dumps({"cells": cells}))
    with pytest.raises(menu.MenuError, match="cell 1 was not run"):
        notebook_pages.format_page(notebook)
