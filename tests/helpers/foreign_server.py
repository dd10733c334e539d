"""A server written from docs/hardware.md alone: plain asyncua, and nothing that is optional."""

import datetime
import random

from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.truststore import TrustStore
from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions

NAMESPACE = "urn:truenewton:bench"
HELD = {"bare": 0.10, "ring": 0.10 + 0.05 / 8}  # N, by each of 8 actuators
KIND = ua.VariantType
FINE = ua.Variant([], KIND.String)


class Operators:
    def __init__(self, password):
        self.known = "operator", password

    def get_user(self, _server, username=None, password=None, certificate=None):
        return User(role=UserRole.User) if (username, password) == self.known else None


async def electronics(address, keys, instrument, gap, x, y, nz):
    """Return a server of 8 actuators that answers as springs do."""
    password = (keys / "password.txt").read_text().strip()
    server = Server(user_manager=Operators(password))
    await server.init()
    server.set_endpoint(address)
    await server.set_application_uri("urn:truenewton:server")
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    server.set_identity_tokens([ua.UserNameIdentityToken])
    await server.load_certificate(keys / "server.der")
    await server.load_private_key(keys / "server-key.pem")
    trusted = TrustStore([keys / "trusted"], [])
    await trusted.load()
    strict = CertificateValidator(CertificateValidatorOptions.TRUSTED_VALIDATION, trusted)
    server.set_certificate_validator(strict)
    space = await server.register_namespace(NAMESPACE)
    node = await server.nodes.objects.add_object(ua.NodeId("Bench", space), f"{space}:Bench")
    state = {"shape": ("bare", [0.0] * 8), "counter": 0}

    def command(_, load, _cycle, _number, _sign, position):
        state["shape"] = load.Value, position.Value
        return [FINE]

    def read(_, samples):
        (load, position), state["counter"] = state["shape"], state["counter"] + 1
        force = [HELD[load] + 1e5 * z + random.gauss(0.0, 1e-5) for z in position]
        unknown = ua.Variant([float("nan")] * 8, KIND.Double)
        return [FINE, ua.Variant(datetime.datetime.now(datetime.UTC), KIND.DateTime),
                ua.Variant(force, KIND.Double), ua.Variant(position, KIND.Double), unknown, unknown,
                ua.Variant(float("nan"), KIND.Double), ua.Variant(state["counter"], KIND.Int64),
                ua.Variant(True, KIND.Boolean)]  # fmt: skip

    def status(_):
        well = ua.Variant("well", KIND.String)
        return [
            FINE,
            ua.Variant(True, KIND.Boolean),
            well,
            ua.Variant(state["counter"], KIND.Int64),
        ]

    variables = {"Gap": gap, "X": x, "Y": y, "Nz": nz, "Id": list(range(1, 9))}
    for name, value in ({"Instrument": instrument} | variables).items():
        kind = {"Instrument": KIND.String, "Id": KIND.Int64}.get(name, KIND.Double)
        here = ua.NodeId(f"Bench.{name}", space), f"{space}:{name}"
        await node.add_variable(*here, ua.Variant(value, kind))
    every = {"Command": command, "Read": read, "Status": status, "Rest": lambda _: [FINE]}
    for name, method in every.items():
        await node.add_method(ua.NodeId(f"Bench.{name}", space), f"{space}:{name}", method)
    return server
