"""Odd numbers and texts."""

from __future__ import annotations

import random

NUMBERS = (
    float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 1.0, -1.0, 1e308, -1e308, 1e-320, 5e-324,
    -1e-320, 1e155, 1e200, 1e-200, 1e30, -1e30, 1e15, 1e-15, 1e9, 1e6, -1e6, 65536.0, 1e3, 1e-3,
    2.0**31, 2.0**63, 9e5, -9e5, 999.0, 9e14, 1e-9, 9e7, 9e3, 1e-5, 0.9999, 9.9, 9e29, 1.1e-9, 0.5,
    2.0, 90.0, 89.9999999,
)  # fmt: skip
INTEGERS = (0, 1, -1, 2, 3, 7, 255, 65536, 2**31 - 1, -(2**31), 2**62, 10**6)
TEXTS = (
    "", " ", "x", "nan", "inf", "1e400", "a" * 3000,
    "\u00e9\u4e2d\U0001f52d", "\x1b[2J\x07", "a\nb",
    "\x00", "../../..", "/", "/dev/zero", "/dev/full", "/dev/null", ".", "%s%n{0}", "'", '"',
    "2026-13-01T00:00:00", "0001-01-01", "9999-12-31T23:59:59", "2026-11-21T09:30:00+14:00", "~",
    "bare", "ring", "ml", "modes", "C:\\x", "-1", "1", "--help", "auto", "1,1", "1,2,3", "99999",
)  # fmt: skip


def number(pick: random.Random) -> float:
    return pick.choice((*NUMBERS, pick.uniform(-2, 2), 10 ** pick.uniform(-40, 40)))
