"""Links, files, commands and options in the documentation exist."""

import ast
import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest
import typer
import yaml

import slgaussian
from flows.cli.app import app

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")], key=lambda page: page.as_posix()
)
MEASURED = [page for page in PAGES if page.parent.name == "measured"]
TALKING = [*PAGES, *sorted((ROOT / "docs").rglob("*.ipynb"))]
"""Pages and notebooks, whose commands must be there."""
COMMANDS = typer.main.get_command(app)
USAGE_ERROR = typer.BadParameter.__base__
"""Of Click, which Typer brings along or imports, depending on its version."""

FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ +(.+?)\s*$", re.MULTILINE)
OWN_FILE = re.compile(
    r"(?<![\w./-])(?:slgaussian|flows|tasks|data_specs|tests|benches|docs|docker)/[\w./*-]+"
    r"\.(?:py|toml|md|yaml|yml|j2|jpg|png|svg|css|ipynb)\b"
)

MEASURED_ON = re.compile(
    r"^Measured on \d{4}-\d\d-\d\d, commit [0-9a-f]{7,40}( with changes)?, "
    r"on \d+ cores \(.+\).*\.$",
    re.MULTILINE,
)

TO_BE_WRITTEN = {"slgaussian/language/mine.py", "tests/language/test_mine.py"}
"""What a reader of the architecture page is shown how to add."""


def read(page: Path) -> str:
    return page.read_text("utf-8")


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def prose(page: Path) -> str:
    return FENCE.sub("", read(page))


def anchor(heading: str) -> str:
    """The fragment that GitHub gives a heading, and the site too."""
    plain = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading)
    return re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")


def resolves(link: str, page: Path) -> bool:
    path, _, fragment = link.partition("#")
    target = (page.parent / path).resolve() if path else page
    if not (target.is_relative_to(ROOT) and target.exists()):
        return False
    return not fragment or fragment in map(anchor, HEADING.findall(prose(target)))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_of_a_page_resolve(page):
    local = [link for link in LINK.findall(prose(page)) if "://" not in link]
    assert [link for link in local if not resolves(link, page)] == []


def test_index_links_every_page():
    index = ROOT / "docs" / "index.md"
    linked = {
        (index.parent / link.partition("#")[0]).resolve() for link in LINK.findall(read(index))
    }
    pages = {page for page in PAGES if page.is_relative_to(index.parent)} - {index}
    assert sorted(name(page) for page in pages - linked) == []


def sources() -> list[Path]:
    folders = ("slgaussian", "flows", "tasks", "data_specs", "tests", "benches", "docs", "docker")
    files = [*ROOT.iterdir(), *(file for folder in folders for file in (ROOT / folder).rglob("*"))]
    return [file for file in files if file.suffix in (".py", ".toml", ".yaml")]


def test_mentioned_files_exist():
    missing = {}
    for file in {*PAGES, *sources()} - {Path(__file__)}:
        for mention in set(OWN_FILE.findall(read(file))) - TO_BE_WRITTEN:
            if not any(ROOT.glob(mention)) and not (file.parent / mention).exists():
                missing.setdefault(name(file), []).append(mention)
    assert missing == {}


def names_in(file: Path) -> set[str]:
    defined = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    return {node.name for node in ast.walk(ast.parse(read(file))) if isinstance(node, defined)}


def test_architecture_page_names_existing_functions():
    page = read(ROOT / "docs" / "architecture.md")
    table = page.partition("## Where is ...?")[2].partition("\n## ")[0]
    rows = [line.split("|")[2:4] for line in table.splitlines() if line.endswith("` |")]
    assert len(rows) > 10
    missing = []
    for files, functions in rows:
        defined = [names_in(ROOT / file) for file in re.findall("`([^`]+)`", files)]
        for function in re.findall("`([^`]+)`", functions):
            if not any(function in names for names in defined):
                missing.append((files, function))
    assert missing == []


def current(page: Path) -> str:
    """Text of a page; of the changelog the topmost section, of a notebook its cells."""
    text = read(page)
    if page.suffix == ".ipynb":
        lines = [
            line
            for cell in json.loads(text)["cells"]
            for line in "".join(cell["source"]).splitlines()
            if cell["cell_type"] == "markdown" or line.startswith("!")
        ]
        return "\n".join(f"`{line[1:]}`" if line.startswith("!") else line for line in lines)
    return "## ".join(text.split("\n## ")[:2]) if page.name == "CHANGELOG.md" else text


def spans(page: Path) -> list[str]:
    """Inline code of a page, each span on one line."""
    code = re.findall(r"(?<!`)`([^`]+)`(?!`)", FENCE.sub("", current(page)))
    return [" ".join(span.split()) for span in code]


def lines_of_code(page: Path) -> list[str]:
    """Lines of a page's code, blocks and spans, with lines that go on joined."""
    blocks = [
        line
        for _, language, code in FENCE.findall(current(page))
        if language not in ("python", "json")
        for line in code.replace("\\\n", " ").splitlines()
    ]
    return blocks + spans(page)


def commands(page: Path) -> list[str]:
    """Every ``slgaussian ...`` of a page's code."""
    lines = [line for line in lines_of_code(page) if not line.lstrip().startswith("#")]
    parts = [part for line in lines for part in re.split(r"&&|\|\||[|;>]", line)]
    return [hit[0] for part in parts if (hit := re.findall(r"(?<!\S)slgaussian [\w-].*", part))]


def find_bench_options(file: Path) -> set[str]:
    """Options that a bench's ``add_argument`` names, or that its usage does."""
    source = read(file)
    calls = re.findall(r"add_argument\(([^)]*)", source) + re.findall(r"sys\.argv.*", source)
    shared = {"-o", "--out"} if "publish(" in source else set()
    return shared | set(re.findall(r"\"(--?[a-z][\w-]*)\"", " ".join(calls)))


def find_bench_problem(line: str) -> str | None:
    """Return the reason why a bench refuses ``python -m benches.... words``, or None."""
    module, *words = re.sub(r"[][]", " ", line).split()
    file = ROOT / (module.replace(".", "/") + ".py")
    if not file.is_file():
        return f"no bench {module}"
    unknown = {word for word in words if re.fullmatch(r"--?[a-z][\w-]*", word)}
    return str(unknown) if (unknown := unknown - find_bench_options(file)) else None


def find_problem(line: str) -> str | None:
    """Return the reason why the command line refuses ``line``, without values of options."""
    words = shlex.split(line, comments=True)[1:]
    command, path = COMMANDS, "slgaussian"
    while hasattr(command, "commands") and words:
        path += f" {words[0]}"
        if (command := command.commands.get(words.pop(0))) is None:
            return f"no command {path!r}"
    try:
        context = command.context_class(command, info_name=path)
        command.make_parser(context).parse_args(words)
    except USAGE_ERROR as error:
        return error.format_message()
    return None


@pytest.mark.parametrize("page", TALKING, ids=name)
def test_commands_and_options_of_a_page_exist(page):
    lines = [line for line in commands(page) if not re.match("slgaussian (--|COMMAND)", line)]
    wrong = {line: reason for line in lines if (reason := find_problem(line))}
    benches = re.findall(r"python3? -m (benches\..*)", "\n".join(lines_of_code(page)))
    wrong |= {line: reason for line in benches if (reason := find_bench_problem(line))}
    assert wrong == {}


@pytest.mark.parametrize("page", MEASURED, ids=name)
def test_measured_page_names_date_commit_and_machine(page):
    """In the form that ``harness.py`` writes; each section of an old bench names its commit."""
    if page.stem == "earlier":
        sections = read(page).split("\n## ")[1:]
        assert [s for s in sections if not re.search("20..-..-.., commit [0-9a-f]{7}", s)] == []
    else:
        assert MEASURED_ON.search(read(page)), "run its maker, which writes that line"


def test_commands_page_lists_each_command_once():
    listed = re.findall(
        r"^\| `slgaussian (\w+)` \|", read(ROOT / "docs/reference/commands.md"), re.M
    )
    assert sorted(listed) == sorted(COMMANDS.commands)


def test_version_is_equal_in_all_files():
    version = tomllib.loads(read(ROOT / "pyproject.toml"))["project"]["version"]
    cited = yaml.safe_load(read(ROOT / "CITATION.cff"))
    assert cited["version"] == version == slgaussian.__version__
    assert f"\n## {version} - " in read(ROOT / "CHANGELOG.md")
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
