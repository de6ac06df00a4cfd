"""Bounds of rounding errors, as functions of precision and size."""

import math
import re

import numpy as np


def epsilon(dtype) -> float:
    """Return the distance from 1 to the next number of a real or complex dtype, of NumPy or torch."""
    name = re.search(r"(float|complex)\d+", str(dtype))[0]
    real = {"complex64": "float32", "complex128": "float64"}.get(name, name)
    return float(np.finfo(real).eps)


def transforms_bound(dtype, samples: int, count: int = 1) -> float:
    """Return a bound of the relative error, in the root mean square, of fast Fourier transforms one after another.

    Each of the log2(samples) stages of a transform rounds every number a few times, by half of ε each; Higham, Accuracy
    and Stability of Numerical Algorithms (2002), theorem 24.2, has 3.3·ε·log2(samples) as the worst case. The errors
    are independent and add as their squares, so that ε·log2(samples) is some five times what is found, on any
    processor and with any number of threads. Products between the transforms are within that margin.
    """
    return count * epsilon(dtype) * math.log2(samples)


def sums_bound(dtype, terms: int) -> float:
    """Return a bound of the relative error of a sum of terms of one sign, in whatever order they are added.

    The errors of n additions are independent, each of at most half of ε times the partial sum: ε·sqrt(n)/2 is reached
    by adding one term after another, ε·log2(n)/2 by pairs, as libraries do (Higham 2002, section 4.2). Four times the
    first is a bound on any processor; where terms cancel it is one of the error relative to the sum of their
    magnitudes.
    """
    return 2 * epsilon(dtype) * math.sqrt(max(terms, 1))


def products_bound(dtype, operations: int) -> float:
    """Return a bound of the relative error of a result after so many products, quotients, roots and functions.

    Each is rounded by half of ε, elementary functions of vector libraries by up to 4·ε (their documented limit).
    """
    return 4 * epsilon(dtype) * max(operations, 1)
