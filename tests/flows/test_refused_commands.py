"""Input that commands refuse before any work: one sentence, status 2, and no file."""

import shlex
import shutil

import pytest
from command import transforms

from slgaussian.field import SemanticField
from slgaussian.formats.ply import save_ply


@pytest.fixture(scope="module")
def place(tmp_path_factory, walls):
    """Return a folder with a field, PLY files, a camera file and an existing output."""
    folder = tmp_path_factory.mktemp("place")
    gaussians = SemanticField.load(shutil.copytree(walls, folder / "field")).gaussians
    save_ply(gaussians, folder / "scene.ply")
    save_ply(gaussians[:0], folder / "empty.ply")
    points = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    (folder / "points.ply").write_text(f"ply\nformat ascii 1.0\n{points}end_header\n1 2 3\n")
    (folder / "folder.ply").mkdir()
    transforms(folder)
    return folder


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("query field red --view nowhere.png", "no view 'nowhere.png'"),
        ("query field red -o a.bmp", "name of a picture to end in .png or .jpg or .jpeg"),
        ("query field red --threshold 2", "threshold"),
        ("query field red --set absent=lerf", "expected one of skip, zero"),
        ("query field red --set seed=3", "seed cannot be changed after the field was built"),
        ("query field red --set lexicon.classifier=none", "lexicon.classifier cannot be changed"),
        ("query field red --preset x", "query: preset: found 'x', expected one of"),
        ("query field", "nothing to look for: give a TEXT, or a picture with --like"),
        ("query field red --camera none.json", "none.json: cannot be read"),
        ("query no red", "no: no field.json there"),
        ("segment field red -o a", "found 'no suffix'"),
        ("segment field red --between 0 1 1.5 -o a.png", "from 0 to 1"),
        ("segment field red --between 0 1 0.5 --view 1 -o a.png", "--view and --between"),
        ("render field -o a.gif", "expected the name of a picture"),
        ("render field -o a.png --depth d.npy --view 0 --view 1", "--depth: is of one view"),
        ("render field -o a.png --depth d.tif", "found '.tif', expected the name of a file"),
        ("render field -o a.png --show code", "--show: found 'code', expected colours or codes"),
        ("render field -o a.png --orbit 4", "expected the name of a film to end in .mp4"),
        ("render field -o a.mp4 --orbit 4 --view 1", "leave out one of them"),
        ("render scene.ply -o a.png", "a .ply has no cameras; add --camera transforms.json"),
        ("render scene.spz -o a.png", "a .spz has no cameras; add --camera transforms.json"),
        ("render scene.ply --cameras transforms.json --view 008 -o a.png", "no view '008'"),
        ("render points.ply --cameras transforms.json -o a.png", "no Gaussians: lacks f_dc_0"),
        ("render empty.ply --cameras transforms.json -o a.png", "empty.ply: has no Gaussians"),
        ("export field -o folder.ply", "folder.ply: cannot be written"),
        ("export field -o scene.splat", "scene.splat: found '.splat', expected the name of the"),
        ("export field -o a.spz --text red", "--text is for pages"),
        ("export field -o a.spz --full", "a.spz: --full is for .ply files; leave it out"),
        ("export field -o a.html --set share=0.5", "only files of this encoder can be given"),
        ("export field -o a.html --text unicorn", "no word 'unicorn' is known"),
        ("objects list field -o a.txt", "expected the name of a picture to end in .png"),
        ("objects extract field 7 -o x.ply", "'7': is no object of the field"),
        ("objects remove field red -o field", "is the field itself"),
        ("objects teach field zorp --at 48 3", "--at 48 3: is outside view 'images/001.png'"),
        ("objects teach field '  ' --at 8 16", "expected 1 to 80 letters"),
        ("objects teach field zorp", "give either the position of an example, --at X Y, or"),
        ("objects teach field zorp --forget", "'zorp': is no taught word; those there are: none"),
        ("field a.png b.png --cameras none.json -o scene.ply", "is not a field"),
        ("field a.png b.png --cameras none.json -o new", "none.json"),
        ("ingest procedural:1 --set size=2x3 -o new", "size: found '2x3'; expected height and"),
        ("dataset new procedural:1 --targets 0", "dataset: targets: found 0"),
        ("dataset new procedural:1 --set images=bmp", "dataset: images: found 'bmp'"),
    ],
)
def test_a_command_that_cannot_be_is_one_sentence(place, monkeypatch, refusal, line, sentence):
    monkeypatch.chdir(place)
    before = sorted(place.rglob("*"))
    assert sentence in refusal(*shlex.split(line))
    assert sorted(place.rglob("*")) == before
