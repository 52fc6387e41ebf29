"""Where a command writes: looked at before it runs, written whole or not at all, named when it fails."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile

__all__ = ["apart", "check_file", "check_folder", "keep", "naming", "whole", "write_text"]


def check_file(path: Path | None, *suffixes: str) -> None:
    """Whether a file can be written, with one of the suffixes if any are given. Raises ValueError."""
    if path is None:
        return
    if suffixes and path.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: {path.suffix or 'no suffix'} is not one of {', '.join(suffixes)}")
    # Where a link leads; the file takes its place from beside it.
    folder = path.resolve().parent
    if path.is_dir():
        raise ValueError(f"{path}: is a folder")
    if not folder.is_dir():
        raise ValueError(f"{path}: there is no folder {folder if path.is_symlink() else path.parent}")
    writable = not path.exists() or os.access(path, os.W_OK)
    # A pipe or a device is written itself.
    beside = (path.exists() and not path.is_file()) or _takes_files(folder)
    if not (writable and beside):
        raise ValueError(f"{path} cannot be written")


def _takes_files(folder: Path) -> bool:
    """Whether a file can be made in a folder: where the system keeps its own, none can, whatever it says."""
    try:
        with TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def apart(files: Mapping[str, Path | str | None]) -> None:
    """Whether what a command reads and writes are different files, by its arguments. Raises ValueError."""
    known: dict[Path, str] = {}
    for name, path in files.items():
        if path is None or (Path(path).exists() and not Path(path).is_file()):
            continue
        place = Path(path).resolve()
        if place in known:
            raise ValueError(f"{name} {path} is the file of {known[place]}: it would be overwritten")
        known[place] = name


def keep(said: str, **files: tuple[Path | None, Callable[[Path], object]]) -> None:
    """Writes the files of a command, each by its function, then prints what the command says and names them
    by their titles: a console that fails loses nothing. Where a file fails, the rest is printed as well."""
    written = []
    try:
        for title, (path, write) in files.items():
            if path is not None:
                with naming(path):
                    write(path)
                written.append(f"{title.replace('_', ' ')}: {path}")
    finally:
        print("\n".join([said, *written]))


def check_folder(path: Path) -> None:
    """Makes a folder for several files where there is none. Raises OSError, ValueError if nothing can be
    written into it."""
    path.mkdir(parents=True, exist_ok=True)
    if not os.access(path, os.W_OK):
        raise ValueError(f"{path}: nothing can be written into this folder")


@contextmanager
def naming(path: str | os.PathLike[str], part: Path | None = None) -> Iterator[None]:
    """Names the file in an OSError of writing it, which the system leaves out when a disk is full, or where
    it names the part that is written in its place."""
    try:
        yield
    except OSError as error:
        other = error.filename is not None and (part is None or error.filename not in (part, str(part)))
        if other or error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A file beside `path` to be written in its place, which takes it at the end; nothing is left of it after
    an error. What is no file, a pipe or a device, is written itself. Raises FileNotFoundError where there is
    no such folder."""
    if not path.absolute().parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent}")
    if path.exists() and not path.is_file():
        with naming(path):
            yield path
        return
    # A link stays one.
    place = path.resolve()
    part = place.with_name(f".{uuid.uuid4().hex}{place.suffix}")
    try:
        with naming(path, part):
            yield part
            os.replace(part, place)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Writes a text, whole or not at all."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")
