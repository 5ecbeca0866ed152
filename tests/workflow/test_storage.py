"""The workflow with a bucket in place of a shared disk gives the bytes of a local run."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from house import House

boto3 = pytest.importorskip("boto3", reason="no bucket: `make cluster` installs one")
server = pytest.importorskip("moto.server", reason="no bucket: `make cluster` installs one")
pytestmark = pytest.mark.cluster

BUCKET = "eit"
LOGIN = {
    "AWS_ACCESS_KEY_ID": "anybody",
    "AWS_SECRET_ACCESS_KEY": "anything",
    "AWS_DEFAULT_REGION": "us-east-1",
}


@pytest.fixture
def endpoint() -> Iterator[str]:
    """Where a server of buckets listens on loopback, with one empty bucket."""
    running = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    url = f"http://{host}:{port}"
    client(url).create_bucket(Bucket=BUCKET)
    yield url
    running.stop()


def client(url: str):
    key, secret, region = LOGIN.values()
    login = {"aws_access_key_id": key, "aws_secret_access_key": secret, "region_name": region}
    return boto3.client("s3", endpoint_url=url, **login)


def fetched(url: str, folder: Path) -> House:
    """The results that the bucket holds, in a folder."""
    s3 = client(url)
    pages = s3.get_paginator("list_objects_v2").paginate(Bucket=BUCKET, Prefix="results/")
    for page in pages:
        for item in page["Contents"]:
            file = folder / item["Key"]
            file.parent.mkdir(parents=True, exist_ok=True)
            s3.download_file(BUCKET, item["Key"], str(file))
    return House(folder)


def test_a_bucket_gets_the_bytes_of_a_local_run(fresh, finished, endpoint, tmp_path):
    house = fresh.copy(tmp_path / "house")
    given = (
        "--shared-fs-usage=none",
        "--default-storage-provider=s3",
        f"--default-storage-prefix=s3://{BUCKET}",
        f"--storage-s3-endpoint-url={endpoint}",
    )
    environment = house.environment | LOGIN

    def run(*arguments: str) -> str:
        command = house.command(*given, *arguments)
        done = subprocess.run(
            command, cwd=house.folder, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
        return done.stdout + done.stderr

    run()
    bucket = fetched(endpoint, tmp_path / "bucket")
    assert bucket.results() == finished.results()
    assert set(bucket.digests()) == set(finished.digests())
    assert not (house.folder / "results").exists()  # nothing beside the bucket
    assert "Nothing to be done" in run("--dry-run")
    assert "figure_2" in run("--dry-run", "paper")
