"""Python blocks, commands, links and column lists of the READMEs and of the documentation."""

import re
import sys
import tomllib
from pathlib import Path

import pytest
import trimesh

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

from column_lists import list_unknown_columns  # noqa: E402
from run_blocks import check_commands, read_blocks, read_commands, run_blocks  # noqa: E402

FOLDERS = ("meshes", "protocols", "examples", "tests", "tests/ibsi", "pssf/study")
READMES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / folder / "README.md" for folder in FOLDERS)]
PAGES = sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)
EVERYWHERE = [*READMES, ROOT / "CHANGELOG.md", *PAGES]
WITH_PYTHON = [path for path in [*READMES, *PAGES] if read_blocks(path)]
WITH_COMMANDS = [path for path in [*READMES, *PAGES] if read_commands(path)]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def name_page(path):
    return str(path.relative_to(ROOT))


def list_anchors(path):
    """List the anchors that a Markdown viewer gives to the headings of a page."""
    text = re.sub(r"^```.*?^```$", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def list_broken_links(path):
    """List the relative links of a page that lead to no file or to no heading."""
    text = re.sub(r"^```.*?^```$", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
    broken = []
    for link in LINK.findall(text):
        if re.match(r"\w+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (path.parent / file).resolve() if file else path
        if not target.exists() or (anchor and anchor not in list_anchors(target)):
            broken.append(link)
    return broken


def list_unknown_parts(command):
    """List the extras, dependency groups and files of a command that the project does not have."""
    extras = {*PROJECT["project"]["optional-dependencies"]}
    asked = [name for names in re.findall(r"\[([\w,]+)\]'", command) for name in names.split(",")]
    unknown = {*asked, *re.findall(r"--extra (\S+)", command)} - extras
    unknown |= {*re.findall(r"--group (\S+)", command)} - {*PROJECT["dependency-groups"]}
    files = [word for word in command.split() if re.fullmatch(r"(examples|tests|docs)/[\w/]+\.py", word)]
    return sorted(unknown | {file for file in files if not (ROOT / file).exists()})


@pytest.mark.parametrize("path", WITH_PYTHON, ids=name_page)
def test_the_python_blocks_of_a_page_run(path, tmp_path):
    # The examples on the page read meshes of the user; spheres replace these meshes.
    for name, radius_mm in (("leg", 60.0), ("femur", 15.0), ("screw", 3.0)):
        trimesh.creation.icosphere(subdivisions=2, radius=radius_mm).export(tmp_path / f"{name}.stl")
    assert run_blocks(path, tmp_path)


def test_a_failing_block_names_its_page_and_line(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("text\n\n```python\nright = 1\nwrong = right / 0\n```\n")
    with pytest.raises(ZeroDivisionError) as caught:
        run_blocks(page, tmp_path)
    assert (caught.traceback[-1].path, caught.traceback[-1].lineno + 1) == (page, 5)


@pytest.mark.parametrize("path", WITH_COMMANDS, ids=name_page)
def test_the_commands_of_a_page_exist_with_their_options(path):
    assert check_commands(path) == []
    assert [part for command in read_commands(path) for part in list_unknown_parts(command)] == []


@pytest.mark.parametrize(
    "line",
    [
        "```console\n$ pssf simulate --greade 2 --out x\n```\n",
        "    uv run pssf simulat\n",
        "    pip install uv && uv run pssf study --no-such-option\n",
        "    uv run --extra nothing pssf protocols\n",
        "    pip install '.[study,nothing]'\n",
        "    uv run python examples/nothing.py\n",
    ],
)
def test_a_wrong_command_is_detected(line, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(line)
    assert check_commands(page) or [part for command in read_commands(page) for part in list_unknown_parts(command)]


@pytest.mark.parametrize("path", EVERYWHERE, ids=name_page)
def test_the_links_of_a_page_lead_to_files_and_headings(path):
    assert list_broken_links(path) == []


def test_a_broken_link_is_detected(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# One\n[a](#one) [b](#two) [c](page.md#one) [d](none.md) [e](https://example.org)\n")
    assert list_broken_links(page) == ["#two", "none.md"]


@pytest.mark.parametrize("path", READMES, ids=name_page)
def test_a_readme_is_short_and_has_no_measured_table(path):
    text = path.read_text()
    assert len(text.split()) <= {"README.md": 900, "CONTRIBUTING.md": 600}.get(name_page(path), 400)
    assert "<!-- table" not in text


def test_the_front_page_has_the_two_main_commands():
    text = (ROOT / "README.md").read_text()
    assert "pip install uv && uv run pssf study --preset quick --out runs/quick" in text
    assert "pip install uv && uv run pytest" in text


def test_every_column_of_a_cohort_is_described(whole_cohort):
    assert list_unknown_columns(whole_cohort) == []


def test_every_column_of_a_study_is_described(film_study):
    assert list_unknown_columns(film_study.report.parent) == []


def test_an_unknown_column_is_detected(tmp_path):
    (tmp_path / "scores.csv").write_text("task,nothing_of_this_name\n")
    (tmp_path / "nothing.csv").write_text("a\n")
    assert list_unknown_columns(tmp_path) == ["nothing.csv", "scores.csv: nothing_of_this_name"]
