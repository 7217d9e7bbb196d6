"""The OpenAPI document describes the API, and its examples are requests the API accepts."""

import pytest

from service.examples import EXAMPLES


def test_document_lists_every_call(client):
    paths = client.get("/openapi.json").json()["paths"]
    calls = {(verb, path) for path, item in paths.items() for verb in item}
    assert {
        ("get", "/models"), ("get", "/models/{name}"), ("post", "/jobs"), ("get", "/jobs"),
        ("get", "/jobs/{job_id}"), ("delete", "/jobs/{job_id}"), ("get", "/jobs/{job_id}/trace"),
        ("post", "/jobs/{job_id}/stop"), ("get", "/jobs/{job_id}/results"), ("get", "/livez"),
    } <= calls  # fmt: skip


@pytest.mark.long
def test_keys_are_described_where_they_are_needed(client, make_client, tmp_path):
    (tmp_path / "keys").write_text(f"anna {'0' * 64}\n")
    keyed = make_client(keys_file=tmp_path / "keys").get("/openapi.json").json()
    plain = client.get("/openapi.json").json()
    for path, item in plain["paths"].items():
        for verb, call in item.items():
            assert "security" not in call, path
            assert "401" not in call["responses"], path
            needed = path not in ("/", "/livez", "/readyz")
            assert ("security" in keyed["paths"][path][verb]) == needed, path
    assert "securitySchemes" not in plain["components"]


@pytest.mark.long
@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_are_accepted_and_run_to_the_end(client, ended, name):
    operation = client.get("/openapi.json").json()["paths"]["/jobs"]["post"]
    example = operation["requestBody"]["content"]["application/json"]["examples"][name]["value"]
    answer = client.post("/jobs", json=example)
    assert answer.status_code == 201, answer.text
    assert ended(client, answer.headers["location"])["status"] == "successful"
