"""Credentials in URLs appear in no message or file."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.storage.remote import check_url, redact
from slgaussian.storage.store import ArtifactStore

SECRETS = [
    "s3://AKIA123:ab/cd+ef@bucket/prefix",
    "https://me:hidden@host:8080/chunks",
    "ftp://me:hidden@host/a",
    "simplecache::s3://AKIA123:hidden@bucket",
    "s3://bucket/a?key=AKIA123&secret=hidden",
    "https://host/a?X-Amz-Signature=hidden&x=1",
    "https://host/a?sv=1&sig=hidden",
]


@pytest.mark.parametrize("url", SECRETS)
def test_check_url_refuses_credentials_without_repeating_them(url):
    for refuse in (ArtifactStore, lambda place: check_url(place, "chunks")):
        with pytest.raises(InputError, match="found credentials in the URL") as error:
            refuse(url)
        for secret in ("hidden", "AKIA123", "ab/cd+ef"):
            assert secret not in str(error.value)


@given(
    st.text("abcXYZ019+/=-_.%", min_size=1).filter(lambda s: not s[0].isdigit()),
    st.text("abcXYZ019", min_size=1),
)
def test_redact_masks_every_password(password, user):
    masked = redact(f"could not reach s3://{user}:{password}@bucket/x, nor gs://other/y")
    assert masked == "could not reach s3://***@bucket/x, nor gs://other/y"
