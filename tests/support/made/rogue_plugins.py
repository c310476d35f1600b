"""Plugins that raise, hang or die."""

from __future__ import annotations

ROGUES = """
import ctypes, os, signal, sys, time
from dataclasses import dataclass
import numpy as np
from featreg.errors import InputError
from featreg.interfaces import Matcher
from featreg.types import Matches


def crash():
    ctypes.string_at(0)


@dataclass(frozen=True)
class Good(Matcher):
    def match(self, reference, secondary):
        xy = np.random.default_rng(0).uniform(5, 60, (40, 2))
        return Matches(xy, xy + (2.0, 1.0), np.ones(40))


@dataclass(frozen=True)
class Raises(Good):
    def match(self, reference, secondary):
        raise ValueError("the plugin fell over")


@dataclass(frozen=True)
class Hangs(Good):
    def match(self, reference, secondary):
        time.sleep(600)


@dataclass(frozen=True)
class Dies(Good):
    def match(self, reference, secondary):
        crash()


@dataclass(frozen=True)
class Exits(Good):
    def match(self, reference, secondary):
        sys.exit("enough")


def cut_off():
    # Killed in the middle of handing its result back, as by the system when memory is short.
    from multiprocessing import connection

    def half(self, content):
        os.write(self.fileno(), bytes(content)[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    connection.Connection._send = half
    return bytes(1 << 20)


STATE = {"poisoned": False}


def poison():
    STATE["poisoned"] = True


def delicate():
    if STATE["poisoned"]:
        os.kill(os.getpid(), signal.SIGKILL)
    return "well"


class Odd(Exception):
    def __init__(self, a, b):
        super().__init__(a)


def odd():
    raise Odd("an exception that goes into a pickle and never comes out", 2)


def unsendable():
    return lambda: 1


def refuse(text):
    raise InputError(text)


def threads():
    import cv2
    return os.environ["OMP_NUM_THREADS"], cv2.getNumThreads(), os.getpid()


def sleep(seconds):
    time.sleep(seconds)
    return seconds
"""
