"""Deployments on a real server: forms take what files take, and one deployment starts another."""

import json
from pathlib import Path
from typing import get_type_hints

import pytest
import yaml
from command import ROOM
from prefect.flows import load_flow_from_entrypoint
from prefect.utilities.callables import parameter_schema
from tiny_program import wait_until
from web import call_prefect, post, serve_prefect, start_prefect

from flows.config import PRESETS
from flows.read_config import validate_settings
from flows.runners.environment import FLOWS
from slgaussian import __version__, datasets
from slgaussian.datasets import re10k
from slgaussian.errors import InputError

ROOT = Path(__file__).parents[2]
CORPUS = {"sources": ["chunks"], "out": "out"}
REQUIRED = {
    "run": {},
    "ingest": CORPUS,
    "supervise": CORPUS,
    "dataset": CORPUS,
    "train": {"lessons": "corpus", "out": "out"},
    "retrain": {**CORPUS, "models": "models"},
}
ACCEPTED = [
    *(("run", {"preset": name}) for name in PRESETS),
    *(("run", {"size": s}) for s in ("64x96", [64, 96], "auto", "original", "at most 416x576")),
    *(("run", {"runner": r}) for r in ("processes", "dask://10.0.0.5:8786", "ray://head:10001")),
    ("run", {"preset": "paper", "threshold": 0.4, "lexicon": {"classifier": "lite0"}}),
    ("run", {"near": 0.5, "far": 10, "canonical": "lerf", "sam": {"points": 8}}),
    ("run", {"near": None, "far": None, "replicas": None}),
    ("run", {"sweep": ["planesweep.depth_candidates=32,64", "views=2,3"], "against": ["all"]}),
    ("run", {"rooms": "0-3", "scenes": [{**ROOM, "size": "64x96", "queries": ["red ball"]}]}),
    ("ingest", {"sources": ["office=walk", "s3://bucket/chunks", "procedural:0-3"]}),
    *((command, {"size": s}) for command in ("supervise", "dataset") for s in ("64x96", [64, 96])),
    ("train", {"preset": "paper"}),
    *((command, {"widths": w}) for command in ("train", "retrain") for w in ("8,16", [8, 16])),
]
REFUSED = [
    *(("run", {"size": size}) for size in ("abc", "64", "at most", [64], [64, 96, 3], 64)),
    *(("run", {"preset": preset}) for preset in ("papr", 3)),
    *(("run", {"runner": runner}) for runner in ("dask", "dask://host", "thread")),
    *(("run", values) for values in ({"replica": 5}, {"replicas": 0}, {"threshold": 2})),
    *(("run", values) for values in ({"encoder": "clipp"}, {"clip": {"crops": "square"}})),
    ("run", {"scenes": [{"name": "a", "context": ["1"]}]}),
    *(("supervise", values) for values in ({"size": "auto"}, {"sources": []}, {"preset": "fast"})),
    *(("train", {"widths": widths}) for widths in ("8,x", "8,0", "", [8, 0], [])),
    *(("train", values) for values in ({"preset": "fast"}, {"held_out": 1})),
]


@pytest.fixture(scope="module")
def forms(server):
    """Return flow, its schema and the address for runs of a deployment, by command."""
    output = {}
    for command in REQUIRED:
        flow = load_flow_from_entrypoint(FLOWS[command].replace(":", "."))
        schema = parameter_schema(flow.fn).model_dump_for_openapi()
        name = {"name": f"form of {flow.name}"}
        flow_id = post(f"{server.url}/flows/", name).json()["id"]
        deployment = {**name, "flow_id": flow_id, "parameter_openapi_schema": schema}
        deployment["enforce_parameter_schema"] = True
        answer = post(f"{server.url}/deployments/", deployment)
        url = f"{server.url}/deployments/{answer.json()['id']}/create_flow_run"
        output[command] = flow, schema, url
    return output


@pytest.mark.parametrize(("command", "values"), ACCEPTED)
def test_a_form_takes_what_a_file_takes_and_means_the_same(forms, command, values):
    flow, _, url = forms[command]
    parameters = {"config": {**REQUIRED[command], **values}}
    answer = post(url, {"parameters": parameters})
    assert answer.status_code == 201, answer.text
    config = flow.validate_parameters(parameters)["config"]
    assert config == validate_settings(type(config), parameters["config"], "test")
    if values.get("preset") == "paper":
        assert config.codes == "grid"


@pytest.mark.parametrize(("command", "values"), REFUSED)
def test_a_form_refuses_what_a_file_refuses(forms, command, values):
    flow, _, url = forms[command]
    parameters = {"config": {**REQUIRED[command], **values}}
    answer = post(url, {"parameters": parameters})
    assert answer.status_code in (409, 422), answer.text
    with pytest.raises(InputError):
        validate_settings(get_type_hints(flow.fn)["config"], parameters["config"], "test")


def test_a_run_of_a_deployment_refuses_with_the_sentence_of_a_file(forms):
    flow, _, url = forms["run"]
    sides = {"config": {"size": "9000x64"}}  # a pattern of text has no bounds
    assert post(url, {"parameters": sides}).status_code == 201
    with pytest.raises(Exception, match="size: found '9000x64'; expected height and width as in"):
        flow.validate_parameters(sides)


@pytest.mark.parametrize("command", REQUIRED)
def test_a_form_has_the_data_first_and_sends_no_default(forms, command):
    """Prefect's page sends the defaults that it shows; they would override a preset."""
    _, schema, _ = forms[command]
    assert '"default"' not in json.dumps(schema["definitions"])
    model = schema["properties"]["config"]["$ref"].rpartition("/")[2]
    fields = schema["definitions"][model]["properties"]
    ordered = sorted(fields.values(), key=lambda field: field["position"])
    groups = list(dict.fromkeys(field["title"].partition(":")[0] for field in ordered))
    order = ["Run", "Samples", "Training", "Method", "Answers", "Components", "Engine"]
    assert groups == [group for group in order if group in groups] and groups[-1] == "Engine"
    first = "data" if command == "run" else "lessons" if command == "train" else "sources"
    assert ordered[0]["title"] == f"Run: {first}"


@pytest.mark.whole
def test_ingest_starts_supervise_and_that_retrain(tmp_path):
    """By the commands of the guide: a server, a copy of prefect.yaml, and a worker."""
    clip = re10k.encode_clip(datasets.load("procedural", seed=0, views=6, height=90, width=160))
    re10k.write(tmp_path / "chunks", [clip])
    (tmp_path / "nothing").mkdir()
    content = yaml.safe_load((ROOT / "prefect.yaml").read_text())
    for deployment in content["deployments"]:
        if deployment["name"] in ("ingest", "lessons", "retrain"):
            deployment["parameters"]["config"] |= {"size": "48x64", "most": 1, "replicas": 1}
    # The first run ends as LeftOut, and the second as Completed.
    content["deployments"][0]["parameters"]["config"]["sources"].append("nothing")
    (tmp_path / "prefect.yaml").write_text(yaml.safe_dump(content))
    variables = {"PREFECT_WORKER_QUERY_SECONDS": "1"}
    with serve_prefect(tmp_path, **variables) as env:

        def runs() -> dict[str, dict]:
            which = {"flow_runs": {"start_time": {"is_null_": False}}}
            found = post(f"{env['PREFECT_API_URL']}/flow_runs/filter", which).json()
            return {run["name"]: run for run in found}

        call_prefect(tmp_path, env, *["work-pool", "create", "slgaussian", "--type", "process"])
        call_prefect(tmp_path, env, "deploy", "--all")
        with start_prefect(tmp_path, env, "worker", "start", "--pool", "slgaussian"):
            call_prefect(tmp_path, env, "deployment", "run", "slgaussian-ingest/ingest")
            assert wait_until(lambda: "retrain models" in runs(), 500), runs().keys()
            ended = runs()
    first, second, third = (
        ended[name] for name in ("ingest corpus", "supervise corpus", "retrain models")
    )
    assert (first["state_name"], second["state_name"]) == ("LeftOut", "Completed")
    assert second["created_by"]["display_value"] == "lessons after ingest"
    assert third["created_by"]["display_value"] == "retrain after lessons"
    assert {"supervise", "chunks", f"slgaussian {__version__}"} <= set(second["tags"])
