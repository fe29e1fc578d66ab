"""Promises of ``docs/guides/security.md`` that the tests of damaged files do not cover."""

import ast
import io
import json
import re
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from slgaussian.benchmark.annotations import label_files, read_labels
from slgaussian.benchmark.outputs import file_name, mask_paths, write_file
from slgaussian.components.pretrained import find_model
from slgaussian.datasets import nerfstudio, re10k
from slgaussian.datasets.photographs import open_photograph, stored_size
from slgaussian.datasets.sharpness import glance
from slgaussian.errors import InputError, SpecError
from slgaussian.formats.images import open_image, read_npy
from slgaussian.formats.strict_json import parse
from slgaussian.masks.precomputed import read_ids
from slgaussian.predict.mvsplat.checkpoint import read_state
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from slgaussian.storage.tables import read_table

ROOT = Path(__file__).parent.parent
OWN = [path for part in ("slgaussian", "tasks", "flows") for path in (ROOT / part).rglob("*.py")]
BAD_NAMES = [
    "../up", "../../../../../../tmp/up", "/etc/up", "a/../../up", "..", ".", "", "a\0b", "a\\..\\b",
    "C:\\up", "NUL", "con.txt", "x" * 5000, "é" * 300, "\ud800", "\x1b[2Jcup", "a\nb",
]  # fmt: skip


def huge_png(width: int = 30_000, height: int = 30_000) -> bytes:
    """Return a PNG with a huge size in its header and no pixels."""
    out = b"\x89PNG\r\n\x1a\n"
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    for kind, content in ((b"IHDR", head), (b"IDAT", zlib.compress(b"")), (b"IEND", b"")):
        chunk = kind + content
        out += struct.pack(">I", len(content)) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return out


def find_calls(tree: ast.AST) -> list[tuple[str, ast.Call]]:
    """Every call in a module with the dotted name of what is called."""
    return [(ast.unparse(n.func), n) for n in ast.walk(tree) if isinstance(n, ast.Call)]


class TestNoCodeIsLoaded:
    def test_modules_neither_unpickle_nor_unpack(self):
        loads = {
            "pickle.load", "pickle.loads", "pickle.Unpickler", "marshal.loads", "marshal.load",
            "shelve.open", "joblib.load", "dill.load", "cloudpickle.load", "cloudpickle.loads",
            "yaml.load", "yaml.unsafe_load", "pd.read_pickle", "eval", "exec",
        }  # fmt: skip
        assert OWN
        for path in OWN:
            for name, call in find_calls(ast.parse(path.read_text("utf-8"))):
                # What a run sends to its own workers, whose runners pickle it anyway.
                if (path.name, name) != ("batches.py", "pickle.loads"):
                    assert name not in loads, f"{path}:{call.lineno}"
                assert name.rpartition(".")[2] not in ("extractall", "extract", "unpack_archive")
                keywords = {k.arg: ast.unparse(k.value) for k in call.keywords}
                assert keywords.get("allow_pickle", "False") == "False", f"{path}:{call.lineno}"
                assert keywords.get("trust_remote_code", "False") == "False"
                if name == "torch.load":
                    assert path.name == "tensorfile.py"
                    assert keywords["weights_only"] == "True"
                if name.startswith("Image.open"):
                    assert path.name == "images.py"

    @pytest.mark.parametrize("zipped", [True, False])
    def test_read_state_refuses_a_checkpoint_with_code(self, tmp_path, zipped):
        class Trap:
            def __reduce__(self):
                return (tmp_path / "ran").touch, ()

        file = tmp_path / "trap.ckpt"
        content = {"state_dict": {"a": torch.ones(2), "b": Trap()}}
        torch.save(content, file, _use_new_zipfile_serialization=zipped)
        with pytest.raises(InputError, match=r"trap\.ckpt: holds more than tensors \(\S+\)"):
            read_state(file)
        assert not (tmp_path / "ran").exists()

    @staticmethod
    def rewrite(tmp_path, packing, damage=lambda name, data: data):
        """Copy the members of a plain checkpoint to another archive, and read that."""
        torch.save({"a": torch.zeros(1000)}, tmp_path / "plain.ckpt")
        with (
            zipfile.ZipFile(tmp_path / "plain.ckpt") as plain,
            zipfile.ZipFile(tmp_path / "x.ckpt", "w", packing) as copy,
        ):
            for name in plain.namelist():
                copy.writestr(name, damage(name, plain.read(name)))
        assert set(read_state(tmp_path / "plain.ckpt")) == {"a"}
        return read_state(tmp_path / "x.ckpt")

    def test_read_state_refuses_a_packed_checkpoint(self, tmp_path):
        with pytest.raises(InputError, match="it is packed"):
            self.rewrite(tmp_path, zipfile.ZIP_DEFLATED)

    @pytest.mark.parametrize("end", [b"", b"\n.", b"\xa0\n."])
    def test_read_state_refuses_a_global_of_a_million_letters(self, tmp_path, end):
        data = b"\x80\x02ctorch\n" + b"\0" * 10**6 + end
        with pytest.raises(InputError, match="it cannot be unpickled"):
            self.rewrite(
                tmp_path, zipfile.ZIP_STORED, lambda name, old: data if ".pkl" in name else old
            )


class TestLargeImages:
    """Refused by their headers: these files have no pixels that could be decoded."""

    @pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
    @pytest.mark.parametrize("size", [(30_000, 30_000), (10_000, 9_000)])
    def test_readers_refuse_huge_images_by_their_headers(self, tmp_path, size):
        file = tmp_path / "0" / "cup.png"
        file.parent.mkdir()
        file.write_bytes(huge_png(*size))
        (tmp_path / "classes.txt").write_text("cup\n")
        pattern = r"cup\.png: .*it has .* pixels"
        for read in (open_photograph, read_ids, lambda _: read_labels(tmp_path, "0", 8, 8)):
            with pytest.raises(InputError, match=pattern):
                read(file)
        assert stored_size(file) is None

    def test_clips_refuse_huge_frames(self):
        with pytest.raises(InputError, match=r"it has .* pixels"):
            glance(huge_png())
        row = np.array([[1, 1, 0.5, 0.5, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]], np.float32)
        clip = re10k.Clip("a", "", np.zeros(1, np.int64), row, (huge_png(),))
        with pytest.raises(InputError, match=r"clip 'a', frame 0: .*it has .* pixels"):
            clip.view(0)

    @pytest.mark.parametrize("kind", ["png", "npy"])
    def test_nerfstudio_leaves_out_huge_depth(self, tmp_path, kind):
        Image.new("RGB", (8, 6)).save(tmp_path / "a.png")
        depth = tmp_path / f"d.{kind}"
        if kind == "png":
            depth.write_bytes(huge_png())
        else:
            np.lib.format.open_memmap(depth, "w+", np.uint8, (10_000, 9_000))  # a hole on disk
        frame = f'{{"file_path": "a.png", "depth_file_path": "d.{kind}", "fl_x": 9, '
        frame += '"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}'
        (tmp_path / "transforms.json").write_text(f'{{"frames": [{frame}]}}')
        with pytest.warns(UserWarning, match=rf"d\.{kind}: .*it has .* (pixels|numbers)"):
            assert nerfstudio.read(tmp_path).read("a.png").depth is None

    def test_read_chunk_refuses_repeated_tensors(self, tmp_path):
        entry = {
            "key": "a",
            "url": "",
            "timestamps": torch.zeros(50, dtype=torch.int64),
            "cameras": torch.zeros(50, 18),
            "images": [torch.zeros(10_000, dtype=torch.uint8)] * 50,
        }
        torch.save([entry], tmp_path / "x.torch")
        with pytest.raises(InputError, match=r"x\.torch: clip 0: .*has more bytes of images than"):
            re10k.read_chunk(tmp_path / "x.torch")
        stretched = torch.zeros(1, dtype=torch.uint8).expand(10**12)
        torch.save([{**entry, "images": [stretched] * 50}], tmp_path / "x.torch")
        with pytest.raises(InputError, match=r"x\.torch: clip 0: .*repeats its elements"):
            re10k.read_chunk(tmp_path / "x.torch")

    def test_read_npy_refuses_a_shape_beyond_its_file(self, tmp_path):
        with open(tmp_path / "a.npy", "wb") as file:
            head = {"descr": "<f8", "fortran_order": False, "shape": (3_000_000_000, 9)}
            np.lib.format.write_array_header_1_0(file, head)
            file.write(bytes(96))
        with pytest.raises(ValueError, match="mmap length is greater than file size"):
            read_npy(tmp_path / "a.npy")

    def test_opened_refuses_other_kinds_of_file(self, tmp_path):
        """Pillow would start Ghostscript for this file under any name."""
        (tmp_path / "a.png").write_bytes(
            b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EOF\n"
        )
        assert Image.open(tmp_path / "a.png").format == "EPS"
        refusal = pytest.raises(ValueError, match="not an image of a supported format")
        with refusal, open_image(tmp_path / "a.png"):
            pass


class TestNames:
    @given(st.text(max_size=200) | st.sampled_from(BAD_NAMES))
    def test_file_name_is_one_part_of_a_path(self, text):
        name = file_name(text)
        assert Path(name).parts == (name,)
        assert name not in (".", "..")
        assert name.isascii() and name.isprintable()
        assert len(f"{name}.png") <= 255
        assert name.partition(".")[0].upper() not in ("CON", "NUL", "AUX", "PRN", "COM1", "LPT9")

    @pytest.mark.parametrize("name", BAD_NAMES)
    def test_mask_paths_stay_in_their_folder(self, tmp_path, name):
        out = tmp_path / "a" / "out"
        row = {"method": name, "protocol": f"{name}@1", "scene": name, "frame": "f", "query": name}
        place = out / mask_paths([row])[0]
        write_file(place, b"mask")
        (file,) = [path for path in tmp_path.rglob("*") if path.is_file()]
        assert file == place
        assert file.resolve().is_relative_to(out.resolve())

    @pytest.mark.parametrize("name", [n for n in BAD_NAMES if n.isprintable()])
    def test_chunks_of_any_key_stay_in_their_folder(self, tmp_path, name):
        row = np.zeros((1, 18), np.float32)
        clip = re10k.Clip(name, "", np.zeros(1, np.int64), row, (b"x",))
        (chunk,) = re10k.write(tmp_path / "out", [clip])
        assert re10k.read_index(tmp_path / "out") == {name: chunk}
        files = {path for path in tmp_path.rglob("*") if path.is_file()}
        assert files == {tmp_path / "out" / chunk, tmp_path / "out" / "index.json"}

    @pytest.mark.parametrize("name", ["../x.torch", "/etc/passwd", "a/b.torch", 3])
    def test_read_index_refuses_chunks_elsewhere(self, tmp_path, name):
        (tmp_path / "index.json").write_text(json.dumps({"key": name}))
        with pytest.raises(InputError, match=r"index\.json: expected the name of a chunk"):
            re10k.read_index(tmp_path)

    @pytest.mark.parametrize("name", ["../up", "/etc/up", "a\0b", "x" * 300])
    def test_label_files_refuse_masks_elsewhere(self, tmp_path, name):
        (tmp_path / "classes.txt").write_text(f"{name}\n")
        with pytest.raises(InputError, match=r"classes\.txt: the class .* can be no file's name"):
            label_files(tmp_path, "0")

    def test_store_refuses_a_ref_outside(self, tmp_path):
        store = ArtifactStore(tmp_path / "store")
        digest = "../../../up"
        ref = ArtifactRef("labels", f"labels/{digest[:2]}/{digest}.npz", digest)
        for ask in (store.get, store.check):
            with pytest.raises(SpecError, match="expected that of the path"):
                ask(ref)

    def test_store_writes_no_member_of_an_array_file(self, tmp_path):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as archive:
            archive.writestr("../../up.npy", b"no array")
        digest = "0" * 64
        ref = ArtifactRef("labels", f"labels/00/{digest}.npz", digest)
        store = ArtifactStore(tmp_path / "a" / "store")
        store.write(ref.uri, out.getvalue())
        with pytest.raises(SpecError):
            store.get(ref)
        assert list(tmp_path.rglob("*up*")) == []


def test_errors_escape_control_characters():
    message = str(InputError(f"a\x1b[2J\nb\x9b {'x' * 5000} /{'y' * 255} \ud800"))
    assert message == f"a\\x1b[2J\\nb\\x9b {'x' * 100}… /{'y' * 255} \\ud800"


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a":' * 100_000, '"\\ud800"', b"\xff", "", "9" * 5000]
    + [f'{{"a": [{number}]}}' for number in ("1e400", "-1e400", "9" * 400)],
)
def test_parse_refuses_invalid_json(text):
    with pytest.raises(ValueError):
        parse(text)


@pytest.mark.parametrize("value", ["1e400", "true", "[[]]", "null", "0.5", '"../x"'])
def test_find_model_refuses_a_bad_index(tmp_path, value):
    """Its values in turn."""
    name = "model.safetensors.index.json"
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "model-1.safetensors").write_bytes(b"")
    (tmp_path / name).write_text('{"weight_map": {"a": "model-1.safetensors"}}')
    find_model(tmp_path)
    for content in (value, f'{{"a": {value}}}'):
        (tmp_path / name).write_text(f'{{"weight_map": {content}}}')
        with pytest.raises(InputError, match=rf"{re.escape(name)}: "):
            find_model(tmp_path)


@pytest.mark.parametrize("nested", [False, True])
def test_read_table_counts_repeated_texts_before_unpacking(nested):
    texts = pa.DictionaryArray.from_arrays(pa.array([0] * 20_000, pa.int32()), ["x" * 1_000_000])
    column = pa.StructArray.from_arrays([texts], ["b"]) if nested else texts
    out = io.BytesIO()
    pq.write_table(pa.table({"a": column}), out, compression="zstd", store_schema=False)
    assert len(out.getvalue()) < 2000
    with pytest.raises(ValueError, match="unpacks to more than 8 GiB"):
        read_table(out.getvalue())
