"""Prepare the scripts of examples/ for sphinx-gallery: add title, text, picture and run time above the code."""

import tomllib
from pathlib import Path
from typing import Any


def write_gallery_sources(docs: Path) -> list[Path]:
    """Write one file per example into ``_gallery_src``, with a docstring that shows the picture of the example.

    Titles, texts and the names of pictures are in ``gallery.toml``, run times in ``gallery_times.toml``.

    Parameters
    ----------
    docs : Path
        Folder of the documentation.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    ValueError
        If ``gallery.toml`` does not list every script of examples/, or if a listed picture does not exist.
    """
    examples, out = docs.parent / "examples", docs / "_gallery_src"
    entries = tomllib.loads((docs / "gallery.toml").read_text(encoding="utf-8"))
    times = tomllib.loads((docs / "gallery_times.toml").read_text(encoding="utf-8"))
    known, found = set(entries), {path.stem for path in examples.glob("*.py")}
    if known != found:
        raise ValueError(f"gallery.toml must list every example once; names that differ: {sorted(known ^ found)}")
    out.mkdir(exist_ok=True)
    for old in out.glob("*.py"):
        if old.stem.split("_", 1)[-1] not in known:
            old.unlink()
    _write_if_changed(out / "GALLERY_HEADER.rst", _HEADER)
    written = []
    for number, (name, entry) in enumerate(entries.items(), start=1):
        source = (examples / f"{name}.py").read_text(encoding="utf-8")
        picture = entry.get("picture", "")
        if picture and not (examples / picture).is_file():
            raise ValueError(f"picture of {name} must be a file in examples/, got {picture}")
        path = out / f"{number:02d}_{name}.py"
        _write_if_changed(path, _make_source(name, entry, source, _describe_time(name, times)))
        written.append(path)
    return written


_HEADER = """
Gallery
=======

Each script in ``examples/`` has one function ``run(out, pixels=2048)``, which writes its files into the folder ``out``.
The tests execute every script with a small detector. ``uv run python examples/NAME.py`` writes the picture of an
example to the folder ``examples``. Scripts without a picture write to ``runs/examples``.

"""


def _make_source(name: str, entry: dict[str, str], source: str, run_time: str) -> str:
    """Replace the docstring of a script by title, picture, text and run time."""
    title, picture = entry["title"], entry.get("picture", "")
    lines = [title, "=" * len(title), "", entry["text"].strip(), ""]
    if picture:
        lines += [f".. image:: /../examples/{picture}", f"   :alt: {entry['alt']}", "   :class: gallery-picture", ""]
    lines += [run_time, "", f"The code is in ``examples/{name}.py``."]
    thumbnail = entry.get("thumbnail", picture)
    comment = f"# sphinx_gallery_thumbnail_path = '../examples/{thumbnail}'\n" if thumbnail else ""
    code = _drop_docstring(source)
    return 'r"""\n' + "\n".join(lines) + '\n"""\n\n' + comment + code.lstrip("\n")


def _describe_time(name: str, times: dict[str, Any]) -> str:
    """Describe the run time of a script in one sentence."""
    if name not in times["cpu_seconds"]:
        return "Run time: not measured yet."
    return f"Run time: {times['cpu_seconds'][name]} s of CPU time ({times['date']}, {times['machine']})."


def _drop_docstring(source: str) -> str:
    """Return the source code of a module without its docstring."""
    return source.split('"""', 2)[2] if source.startswith('"""') else source


def _write_if_changed(path: Path, text: str) -> None:
    """Write a file only if its content changes, because Sphinx builds the page of a changed file again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
