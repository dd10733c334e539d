"""Certificates, private keys and the password of server and client, in a folder of the owner."""

from __future__ import annotations

import datetime
import logging
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from asyncua.crypto.cert_gen import (
    dump_private_key_as_pem,
    generate_private_key,
    generate_self_signed_app_certificate,
)
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID

from truenewton.errors import FormatError, UnreadableFile
from truenewton.files.opening import open_plain
from truenewton.files.outputs import folder_beside

NAMESPACE = "urn:truenewton:bench"
SERVER_URI = "urn:truenewton:server"
CLIENT_URI = "urn:truenewton:client"
USER = "operator"
PASSWORD = "password.txt"
SERVER_CERTIFICATE, SERVER_KEY = "server.der", "server-key.pem"
CLIENT_CERTIFICATE, CLIENT_KEY = "client.der", "client-key.pem"
# What a client needs, by the names that a plan gives them.
CLIENT_FILES = {
    "password_file": PASSWORD,
    "certificate": CLIENT_CERTIFICATE,
    "private_key": CLIENT_KEY,
    "server_certificate": SERVER_CERTIFICATE,
}
TRUSTED = "trusted"  # a folder: the certificates of the clients that are admitted
YEARS = 5
MAX_KEY_BYTES = 2**16
Value = TypeVar("Value")
# If logging is not set up, asyncua would print every refusal, with its traceback.
logging.getLogger("asyncua").addHandler(logging.NullHandler())


def make_keys(folder: str | os.PathLike[str]) -> None:
    """Make the keys of a server and of one client, unless the folder exists."""
    if os.path.lexists(folder):
        return
    with folder_beside(folder, ()) as new:
        new.chmod(0o700)
        (new / TRUSTED).mkdir()
        for certificate, key, uri, use in (
            (SERVER_CERTIFICATE, SERVER_KEY, SERVER_URI, ExtendedKeyUsageOID.SERVER_AUTH),
            (CLIENT_CERTIFICATE, CLIENT_KEY, CLIENT_URI, ExtendedKeyUsageOID.CLIENT_AUTH),
        ):
            private = generate_private_key()
            made = generate_self_signed_app_certificate(
                private,
                uri.removeprefix("urn:"),
                {},
                [x509.UniformResourceIdentifier(uri), x509.DNSName("localhost")],
                [use],
                days=365 * YEARS,
            )
            (new / certificate).write_bytes(made.public_bytes(Encoding.DER))
            _write_secret(new / key, dump_private_key_as_pem(private))
        (new / TRUSTED / CLIENT_CERTIFICATE).write_bytes((new / CLIENT_CERTIFICATE).read_bytes())
        _write_secret(new / PASSWORD, f"{secrets.token_urlsafe(32)}\n".encode())


def _write_secret(path: Path, content: bytes) -> None:
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)


def read_password(path: str | os.PathLike[str]) -> str:
    """Return the password in a file that only its owner may read."""
    password = _parsed(path, "text", lambda content: content.decode().strip(), secret=True)
    if not password:
        raise FormatError("contains no password", remedy="write one line", path=path)
    return password


def read_private_key(path: str | os.PathLike[str]) -> RSAPrivateKey:
    """Return the private key in a PEM file that only its owner may read."""

    def parse(content: bytes) -> RSAPrivateKey:
        key = load_pem_private_key(content, password=None)
        if not isinstance(key, RSAPrivateKey):
            raise TypeError(type(key).__name__)
        return key

    return _parsed(path, "an RSA private key without a passphrase in PEM", parse, secret=True)


def read_certificate(path: str | os.PathLike[str]) -> x509.Certificate:
    """Return a certificate (DER or PEM) that is valid today."""

    def parse(content: bytes) -> x509.Certificate:
        if content.startswith(b"-----"):
            return x509.load_pem_x509_certificate(content)
        return x509.load_der_x509_certificate(content)

    certificate = _parsed(path, "a certificate", parse, secret=False)
    first, last = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if not first <= datetime.datetime.now(datetime.UTC) <= last:
        raise FormatError(
            f"is valid from {first:%Y-%m-%d} to {last:%Y-%m-%d} only",
            remedy="make new keys",
            path=path,
        )
    return certificate


def read_trusted(folder: str | os.PathLike[str]) -> frozenset[bytes]:
    """Return the certificates (DER) of the clients that are admitted."""
    try:
        files = sorted(Path(folder).iterdir())
    except OSError as error:
        raise UnreadableFile(
            f"cannot be read ({error.strerror or error})",
            remedy="check its name; `truenewton serve` makes keys in a folder that does not exist",
            path=folder,
        ) from error
    return frozenset(read_certificate(file).public_bytes(Encoding.DER) for file in files)


def _parsed(
    path: str | os.PathLike[str], what: str, parse: Callable[[bytes], Value], *, secret: bool
) -> Value:
    """Read a file and parse it; only its owner may read a secret one (not checked on Windows)."""
    with open_plain(path) as file:
        mode, content = os.fstat(file.fileno()).st_mode, file.read(MAX_KEY_BYTES)
    if secret and mode & (stat.S_IRWXG | stat.S_IRWXO) and os.name != "nt":
        raise UnreadableFile(
            "may be read by others than its owner", remedy="chmod 600 it", path=path
        )
    try:
        return parse(content)
    except (ValueError, TypeError) as error:
        raise FormatError(
            f"is not {what}", remedy="name another file, or make new keys", path=path
        ) from error
