"""Threefry-2x32, twenty rounds, in Python's whole numbers; and the draws of a run as pcbench promises them.

Source: Salmon, Moraes, Dror, Shaw, Parallel random numbers: as easy as 1, 2, 3, SC 2011, and its constants. A key folds a
number in by hashing (0, number); uniform numbers are the 52 upper bits of 64, normal ones come by the inverse error function.
"""

import numpy as np
from scipy.special import erfinv

MASK = 0xFFFFFFFF
ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
STREAMS = {"initial": 0, "measurement": 1, "drift": 2, "jitter": 3, "loss": 4, "process": 5}
STREAMS |= {"command_jitter": 6, "command_loss": 7, "command": 8, "outlier": 9, "observer": 10, "tail": 11}
STREAMS |= {"delay_chain": 12, "dither": 13, "stamp": 14}


def threefry(key, counter):
    """Two words from two words under two words."""
    keys = (*key, key[0] ^ key[1] ^ 0x1BD11BDA)
    a, b = (counter[0] + keys[0]) & MASK, (counter[1] + keys[1]) & MASK
    for block in range(5):
        for turn in ROTATIONS[block % 2]:
            a = (a + b) & MASK
            b = (((b << turn) | (b >> (32 - turn))) & MASK) ^ a
        a = (a + keys[(block + 1) % 3]) & MASK
        b = (b + keys[(block + 2) % 3] + block + 1) & MASK
    return a, b


def fold(key, *numbers):
    for number in numbers:
        key = threefry(key, (0, number))
    return key


def address(root, seed, stream, channel, sample):
    return fold((root >> 32, root & MASK), seed, STREAMS[stream], channel, sample)


def mantissa(key, i):
    """52 bits of the i-th number under a key, as a fraction in [0, 1)."""
    high, low = threefry(key, (0, i))
    return ((high << 32 | low) >> 12) / 2.0**52


def normal(root, seed, stream, channel, sample):
    low = np.nextafter(-1.0, 0.0)
    return np.sqrt(2) * erfinv(max(low, mantissa(address(root, seed, stream, channel, sample), 0) * (1 - low) + low))


def uniform(root, seed, stream, channel, sample, many):
    key = address(root, seed, stream, channel, sample)
    return [mantissa(key, i) for i in range(many)]
