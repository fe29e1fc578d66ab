"""What a file that this program wrote holds, from the file alone: for ``slgaussian inspect``."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.storage import field_folder
from slgaussian.storage.documents import read_document
from slgaussian.storage.specs import Spec, load_spec, mismatch, parse_label, spec_names
from slgaussian.storage.store import arrays_digest, is_digest, stated, table_digest, unpacked
from slgaussian.storage.tables import read_table

RUN = (
    "artifacts.parquet",
    "failures.parquet",
    "manifest.json",
    "fields.parquet",
    "samples.parquet",
)
"""Files of which the folder of a run's results has one at least."""

GIVEN = "pairs.json"
"""In a run's results: the index that it was given, as it was, in whichever form."""


@dataclass(frozen=True)
class Seen:
    """A field, column, key or tensor: its type, sizes, unit, meaning, and the values it has.

    ``low`` and ``high`` are the least and the greatest of these; ``empty`` counts empty cells.
    """

    name: str
    type: str
    shape: tuple[int, ...] | None = None
    unit: str = ""
    low: float | None = None
    high: float | None = None
    empty: int = 0
    meaning: str = ""


@dataclass(frozen=True)
class Inspected:
    """What a file or folder holds.

    Attributes
    ----------
    path, form : str
        Where it is, and what kind of file: NPZ, Parquet, JSON, safetensors, field, run.
    bytes : int
        Of the file, or of all files that are told of.
    spec : str
        As ``slgaussian/labels@1``; empty where the form has none.
    stated : bool
        Whether the file itself names its spec; files from before they did are known by their name.
    meaning : str
    problem : str
        Why it is not what its spec says; empty if it is.
    digest : str
        SHA-256: of what a table or arrays hold, of other files themselves.
    rows : int or None
        Of a table, or lines of a log.
    fields : tuple of Seen
    axes : {letter: str}
        What the axes of the arrays count.
    made : mapping
        What made it, as the file says it.
    source, licence : str
    holds : tuple of Inspected
        What is in a folder.
    """

    path: str
    form: str
    bytes: int
    spec: str = ""
    stated: bool = True
    meaning: str = ""
    problem: str = ""
    digest: str = ""
    rows: int | None = None
    fields: tuple[Seen, ...] = ()
    axes: Mapping[str, str] = field(default_factory=dict)
    made: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""
    licence: str = ""
    holds: tuple[Inspected, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether it and all that it holds are what their specs say."""
        return not self.problem and all(one.sound for one in self.holds)

    def as_json(self) -> str:
        """All of it as JSON."""
        return json.dumps(asdict(self), indent=1, ensure_ascii=False)


def inspect(path: str | Path) -> Inspected:
    """What is known of a file, of the folder of a field, or of the folder of a run's results.

    Raises
    ------
    InputError
        If there is nothing, or nothing that this program writes.
    SpecError
        If it is damaged.
    """
    path = Path(path)
    if path.is_dir():
        if (path / field_folder.ABOUT).is_file():
            return _field(path)
        if any((path / name).is_file() for name in RUN):
            return _run(path)
        raise InputError(
            f"{path}: found no {field_folder.ABOUT} and none of {', '.join(RUN)} there, expected "
            "the folder of a field or of a run's results"
        )
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a file") from error
    return _reader(path, data)(path, data)


def _reader(path: Path, data: bytes) -> Callable[[Path, bytes], Inspected]:
    if data[:4] == b"PAR1":
        return _table
    if data[:2] == b"PK":
        return _arrays
    if data[8:9] == b"{" and path.suffix == ".safetensors":
        return _tensors
    if data.lstrip()[:1] == b"{":
        return _document
    raise InputError(
        f"{path}: found {len(data)} bytes that are no Parquet, NPZ, safetensors or JSON file, "
        "expected one that slgaussian wrote"
    )


def _spec_of(label: Any, path: Path) -> Spec:
    """The spec that a file names, or that its place or name tells."""
    if label is not None:
        name, _ = parse_label(str(label))
        if name not in spec_names():
            raise mismatch(str(path), "spec", f"{label!r:.80}", f"one of {', '.join(spec_names())}")
        return load_spec(name)
    named = {load_spec(name).file: name for name in spec_names() if load_spec(name).file}
    kept = path.parents[1].name if is_digest(path.stem) else path.stem
    name = named.get(path.name, kept)
    if name in spec_names() and load_spec(name).suffix == path.suffix:
        return load_spec(name)
    raise InputError(
        f"{path}: names no data spec, and neither does its name tell one: slgaussian did not write "
        "it, or wrote it before files said what they are; rename it as it was called, if so"
    )


def _checked(check: Callable[[], object]) -> str:
    try:
        check()
    except SpecError as error:
        return str(error)
    return ""


def _table(path: Path, data: bytes) -> Inspected:
    try:
        said = stated(data)
        table = read_table(data)
        table.validate(full=True)
    except Exception as error:  # a damaged file raises almost anything
        raise _damaged(path, error) from error
    label = said.get("spec")
    spec = _spec_of(label, path)

    def check() -> None:
        spec.check_stated(label, str(path), "make it again")
        spec.check_table(table, str(path))

    return _told(
        path,
        "Parquet",
        data,
        spec,
        said,
        problem=_checked(check),
        digest=table_digest(table),
        rows=table.num_rows,
        fields=tuple(_column(name, table.column(name), spec) for name in table.column_names),
    )


def _column(name: str, data: pa.ChunkedArray, spec: Spec) -> Seen:
    known = spec.columns.get(name)
    low = high = None
    values = pc.list_flatten(data) if pa.types.is_list(data.type) else data
    if pa.types.is_integer(values.type) or pa.types.is_floating(values.type):
        low, high = pc.min_max(values).as_py().values()
    unit, meaning = (known.unit, known.doc) if known else ("", "")
    return Seen(name, str(data.type), None, unit, low, high, data.null_count, meaning)


def _arrays(path: Path, data: bytes) -> Inspected:
    try:
        arrays, said = unpacked(data)
    except Exception as error:  # a damaged file raises almost anything
        names = _members(data)
        if names and not any(name.endswith(".npy") for name in names):
            raise InputError(
                f"{path}: found an archive of {names[0]!r:.60}, expected an NPZ file that "
                "slgaussian wrote"
            ) from error
        raise _damaged(path, error) from error
    label = said.get("spec")
    spec = _spec_of(label, path)

    def check() -> None:
        spec.check_stated(label, str(path), "make it again")
        spec.check_arrays(arrays, str(path))

    return _told(
        path,
        "NPZ",
        data,
        spec,
        said,
        problem=_checked(check),
        digest=arrays_digest(arrays),
        fields=tuple(_array(name, arrays[name], spec) for name in arrays),
        axes=said.get("axes", spec.axes),
    )


def _members(data: bytes) -> list[str]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return archive.namelist()
    except Exception:  # a damaged file raises almost anything
        return []


def _array(name: str, array: np.ndarray, spec: Spec) -> Seen:
    known = spec.fields.get(name)
    low = high = None
    if array.size and array.dtype.kind in "iuf":
        low, high = array.min().item(), array.max().item()
    unit, meaning = (known.unit, known.doc) if known else ("", "")
    kind = "str" if array.dtype.kind == "U" else str(array.dtype)
    return Seen(name, kind, array.shape, unit, low, high, 0, meaning)


def _document(path: Path, data: bytes) -> Inspected:
    first = data.split(b"\n", 1)[0] if path.suffix == ".jsonl" else data
    try:
        content = strict_json.parse(first)
    except ValueError as error:
        raise _damaged(path, error) from error
    label = content.get("spec")
    if label is None and "scenes" in content and content.get("version") == 2:
        spec = load_spec("index")
    else:
        spec = _spec_of(label, path)
    lines = None
    problem = _checked(lambda: read_document(data, spec, str(path)))
    if spec.lines and not problem:
        lines = len(read_document(data, spec, str(path)))
    top = {name: key for name, key in spec.keys.items() if name in content}
    return _told(
        path,
        "JSON",
        data,
        spec,
        content if label is not None else {},
        problem=problem,
        digest=hashlib.sha256(data).hexdigest(),
        rows=lines,
        fields=tuple(
            Seen(name, key.type, unit=key.unit, meaning=key.doc) for name, key in top.items()
        ),
        made=_made_by(content),
    )


def _made_by(content: Mapping[str, Any]) -> dict[str, Any]:
    """What the documents say, each in its way."""
    if "made_by" in content:
        return {"program": content["made_by"], "settings": content.get("settings", {})}
    if isinstance(content.get("slgaussian"), str):
        return {"program": f"slgaussian {content['slgaussian']}"}
    if "command" in content:
        return {"program": f"slgaussian {content.get('version')}", "stage": content["command"]}
    return {}


def _tensors(path: Path, data: bytes) -> Inspected:
    try:
        length = int.from_bytes(data[:8], "little")
        header = strict_json.parse(data[8 : 8 + length])
        said = header.pop("__metadata__", {})
        end = max(one["data_offsets"][1] for one in header.values())
        if 8 + length + end != len(data):
            raise ValueError(f"its tensors take {end} bytes and it has {len(data) - 8 - length}")
        fields = tuple(
            Seen(name, one["dtype"], tuple(one["shape"])) for name, one in sorted(header.items())
        )
        own = strict_json.parse(said["slgaussian"]) if "slgaussian" in said else {}
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise _damaged(path, error) from error
    made = {"settings": own} if own else {"settings": said} if said else {}
    meaning = (
        "Weights of the semantic branch." if own else "Weights; slgaussian did not write them."
    )
    digest = hashlib.sha256(data).hexdigest()
    return Inspected(
        str(path),
        "safetensors",
        len(data),
        meaning=meaning,
        digest=digest,
        fields=fields,
        made=made,
    )


def _told(
    path: Path, form: str, data: bytes, spec: Spec, said: Mapping[str, Any], **more: Any
) -> Inspected:
    known = {
        "spec": said.get("spec", spec.label),
        "stated": "spec" in said,
        "meaning": said.get("meaning", spec.doc),
        "made": said.get("made", {}),
        "source": said.get("source", ""),
        "licence": said.get("licence", ""),
    }
    if is_digest(path.stem) and not more["problem"] and path.stem != more["digest"]:
        more["problem"] = f"{path}: digest: found {more['digest'][:12]}, expected that of its name"
    return Inspected(str(path), form, len(data), **{**known, **more})


def _damaged(path: Path, error: Exception) -> SpecError:
    why = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
    return SpecError(f"{path}: is damaged ({why}); fetch or make it again")


def _folded(path: Path) -> Inspected:
    """As :func:`inspect`, of a file in a folder: what it is not is its problem."""
    try:
        return inspect(path)
    except (InputError, SpecError) as error:
        size = path.stat().st_size if path.is_file() else 0
        return Inspected(str(path), "file", size, problem=str(error))


def _field(path: Path) -> Inspected:
    own = _folded(path / field_folder.ABOUT)
    names = [*field_folder.FILES.values(), "words.npz", "edits.npz", "derived.npz"]
    parts = [_folded(path / name) for name in names if (path / name).is_file()]
    problem = own.problem
    if not problem:
        problem = _checked(lambda: _check_parts(path, {Path(p.path).name: p for p in parts}))
    meaning = load_spec("field_json").doc
    size = own.bytes + sum(part.bytes for part in parts)
    return Inspected(
        str(path), "field", size, own.spec, own.stated, meaning, problem, own.digest,
        made=own.made, holds=(own, *parts),
    )  # fmt: skip


def _check_parts(path: Path, parts: Mapping[str, Inspected]) -> None:
    about, _ = field_folder.read_about(path)
    for spec, digest in about.digests.items():
        name = field_folder.FILES[spec]
        found = parts[name].digest[:12] if name in parts else "no such file"
        if found != digest[:12]:
            expected = f"{digest[:12]} as {field_folder.ABOUT} says; {field_folder.AGAIN}"
            raise mismatch(str(path / name), "digest", found, expected)


def _run(path: Path) -> Inspected:
    files = sorted(path.glob("*.parquet")) + sorted(path.glob("*.json*"))
    holds = [_given(file) if file.name == GIVEN else _folded(file) for file in files]
    holds += [_folded(file) for file in sorted(path.glob("*.safetensors"))]
    fields = sorted(path.glob(f"fields/*/{field_folder.ABOUT}"))
    holds += [_folded(file.parent) for file in fields]
    size = sum(one.bytes for one in holds)
    meaning = "The results of a run: its tables, what it was made of, and the fields of its scenes."
    if any(path.glob("*.tar")):
        meaning = "A training set: its tables; README.md says what is in its shards."
    return Inspected(str(path), "run", size, meaning=meaning, holds=tuple(holds))


def _given(path: Path) -> Inspected:
    """An index; that of another program is in a form of its own, and fails no spec by it."""
    found = _folded(path)
    if not found.problem:
        return found
    meaning = "The index of scenes that the run was given, as it was."
    return Inspected(str(path), "JSON", found.bytes, meaning=meaning)
