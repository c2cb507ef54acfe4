"""Addresses of the Hub: which file they name, and who gets the token."""

import io
import re

import pytest

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.fetching import deadline
from gsgen.contract.fetching.client import WebClient
from gsgen.contract.fetching.deadline import Deadline, NotPublicHostError
from gsgen.contract.fetching.errors import AddressNotAllowed, FetchFailed
from gsgen.contract.inputs.remote_file import ignore_progress
from gsgen.contract.inputs.web_file import hub_file
from support.web.file_server import Served, file_server, redirect_to

TOKEN = "hf_secret"


def read(address: str) -> bytes:
    content = io.BytesIO()
    hub_file(address).copy(content, max_bytes=1 << 20, on_bytes=ignore_progress)
    return content.getvalue()


@pytest.mark.parametrize(
    ("address", "path"),
    [
        ("hf://owner/name/a.ply", "owner/name/resolve/main/a.ply"),
        ("hf://owner/name@v1.0/b/a.ply", "owner/name/resolve/v1.0/b/a.ply"),
        ("hf://owner/name@refs/pr/3/a.ply", "owner/name/resolve/refs%2Fpr%2F3/a.ply"),
        ("hf://datasets/owner/name/a.ply", "datasets/owner/name/resolve/main/a.ply"),
        ("hf://datasets/owner/name@0f3a/a b#?.ply", "datasets/owner/name/resolve/0f3a/a%20b%23%3F.ply"),
        ("hf://spaces/owner/name/a.ply", "spaces/owner/name/resolve/main/a.ply"),
        ("hf://models/owner/name/a.ply", "owner/name/resolve/main/a.ply"),
    ],
)  # fmt: skip
def test_an_address_of_the_hub_names_a_file(
    address: str, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HF_ENDPOINT", raising=False)
    assert hub_file(address).url == f"https://huggingface.co/{path}"


@pytest.mark.parametrize(
    "address",
    [
        "hf://name",
        "hf://owner/name",
        "hf://owner/name/",
        "hf://owner/name@/a.ply",
        "hf://../name/a.ply",
        "hf://owner/name/../../other/name/resolve/main/a.ply",
        "hf://user:password@host/name/a.ply",
    ],
)
def test_a_malformed_address_of_the_hub_is_refused(address: str) -> None:
    with pytest.raises(InputUnreadable, match="is not the address of a file on the Hub"):
        hub_file(address)


def test_the_token_goes_to_the_hub_and_not_to_its_storage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    with file_server({"/blob": b"content"}) as storage:
        answer = redirect_to(storage.address_of("/blob?signature=1"))
        with file_server({"/owner/name/resolve/main/a.ply": answer}) as hub:
            monkeypatch.setenv("HF_ENDPOINT", hub.origin + "/")
            assert read("hf://owner/name/a.ply") == b"content"
    assert [headers.get("Authorization") for _, headers in hub.requests] == [f"Bearer {TOKEN}"]
    assert storage.paths == ["/blob?signature=1"]
    assert TOKEN not in str(storage.requests)


@pytest.mark.parametrize("status", [401, 403, 404])
def test_a_refused_file_of_the_hub_asks_for_a_token(
    status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with file_server({"/owner/name/resolve/main/a.ply": Served(status=status)}) as hub:
        monkeypatch.setenv("HF_ENDPOINT", hub.origin)
        with pytest.raises(FetchFailed, match=str(status)) as error:
            read("hf://owner/name/a.ply")
    assert error.value.where == "hf://owner/name/a.ply"
    assert "HF_TOKEN" in error.value.hint


@pytest.mark.parametrize(
    "target",
    [
        "http://localhost:1/a",
        "http://169.254.169.254/latest/meta-data",
        "http://example.com/a",
        "file:///etc/passwd",
        "https://u:p@example.com/a",
    ],
)
def test_the_hub_leads_to_no_other_plain_server(
    target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with file_server({"/owner/name/resolve/main/a.ply": redirect_to(target)}) as hub:
        monkeypatch.setenv("HF_ENDPOINT", hub.origin)
        with pytest.raises(AddressNotAllowed, match="redirects to"):
            read("hf://owner/name/a.ply")


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.2",
        "10.0.0.1",
        "192.168.1.1",
        "172.16.0.1",
        "169.254.169.254",
        "100.64.0.1",
        "0.0.0.0",
        "224.0.0.1",
        "localhost",
        "[::1]",
        "[fe80::1]",
        "[fd00::1]",
        "[::ffff:10.0.0.1]",
        "[64:ff9b::a00:1]",
        "[2002:a00:1::1]",
    ],
)
def test_the_hub_leads_into_no_private_network(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with file_server({"/owner/name/resolve/main/a.ply": redirect_to(f"https://{host}/a")}) as hub:
        monkeypatch.setenv("HF_ENDPOINT", hub.origin)
        with pytest.raises(AddressNotAllowed, match="expected a public host"):
            read("hf://owner/name/a.ply")


@pytest.mark.parametrize("number", ["8.8.8.8", "2606:4700:4700::1111", "64:ff9b::808:808"])
def test_a_public_host_is_connected_to(number: str) -> None:
    assert deadline._is_public(number)


def test_every_address_of_a_public_host_is_looked_at() -> None:
    with pytest.raises(NotPublicHostError, match=r"127\.0\.0\.1"):
        deadline.connect("127.0.0.1", 1, Deadline(1), encrypted=False, must_be_public=True)


def test_other_servers_lead_to_their_origin_alone() -> None:
    with (
        file_server({"/a": b"content"}) as other,
        file_server({"/a": redirect_to(other.address_of("/a"))}) as server,
        WebClient(server.origin) as client,
        pytest.raises(AddressNotAllowed),
    ):
        client.read(server.address_of("/a"), max_bytes=100)
    assert other.requests == []


@pytest.mark.parametrize("token", ["a b", "a\nb", "ä"])
def test_a_malformed_token_is_not_printed(token: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_TOKEN", token)
    with pytest.raises(ConfigInvalid) as error:
        hub_file("hf://owner/name/a.ply")
    assert re.search(re.escape(token), str(error.value)) is None


def test_a_malformed_endpoint_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_ENDPOINT", "hub.example")
    with pytest.raises(ConfigInvalid, match=r"'hub\.example' is not a web address"):
        hub_file("hf://owner/name/a.ply")
