"""Addresses of object stores and schedulers: what a sentence or a dataset shows of them holds no password and no key."""

import pytest

from pcbench import UserError
from pcbench.dataset import executors, storage
from pcbench.errors import redact_address

SHOWN = {  # by address: what is shown of it
    "results/a@b": "results/a@b",
    "s3://bucket/a": "s3://bucket/a",
    "s3://K:secret@bucket/a": "s3://bucket/a",
    "s3://K:se/secret@bucket/a": "s3://bucket/a",
    "s3://K:se@secret@bucket/a": "s3://bucket/a",
    "s3://K:secret@bucket/a?region=eu&secret_key=secret&scheme=https": "s3://bucket/a?region=eu&scheme=https",
    "abfs://c@account/a?client_secret=secret": "abfs://account/a",
    "gs://b/a#secret": "gs://b/a",
    "s3://b/a?region=eu@secret": "s3://secret",  # after the last @ nothing is a password
    "s3://b?token=secret&SECRET": "s3://b",
    "s3://b?region=x;token=secret": "s3://b",
    "tls://me:secret@10.0.0.1:8786": "tls://10.0.0.1:8786",
}


@pytest.mark.parametrize("address", SHOWN)
def test_an_address_is_shown_without_its_secrets(address):
    assert redact_address(address) == SHOWN[address]


@pytest.mark.parametrize("address", ["nowhere://K:secr/et@b/a", "s3://K:secr@et@", "nowhere://b?client_secret=secret"])
def test_a_place_that_cannot_be_reached_is_named_without_its_secrets(address):
    with pytest.raises(UserError, match="cannot be accessed") as error:
        storage.target(address)
    assert "secr" not in str(error.value)


def test_a_dataset_calls_its_place_without_secrets():
    pytest.importorskip("pyarrow")
    found = storage.target("s3://K:se%2Fcret@bucket/a?region=eu-west-1")
    assert found.name == "s3://bucket/a?region=eu-west-1"
    assert "cret" in found.uri, "another process reaches it"


def test_a_scheduler_that_cannot_be_reached_is_named_without_secrets():
    pytest.importorskip("distributed")
    with (
        pytest.raises(UserError, match=r"--dask: got 'none://10.0.0.1:1'") as error,
        executors.dask("none://me:secret@10.0.0.1:1"),
    ):
        pass
    assert "secret" not in str(error.value)
