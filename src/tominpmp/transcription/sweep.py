r"""The discrete adjoint equation, swept backwards for many functionals at once.

In the paper, the differential of a functional :math:`g(x(1))` (equation 12) is

.. math:: \delta g = T \int_0^1 \langle f_u^T \psi, \delta u \rangle \, d\tau
    + \delta T \int_0^1 \langle \psi, f \rangle \, d\tau, \qquad
    \frac{d\psi}{d\tau} + T f_x^T \psi = 0, \quad \psi(1) = g_x^T,

and that of a functional at another instant (equation 13) begins its costate there. Here
the motion is that of an integrator, and the derivatives are exactly those of its steps.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.transcription.rollout import Sensitivities


def sweep_adjoint(
    sensitivities: Sensitivities, nodes: IntArray, seeds: Array
) -> tuple[Array, Array]:
    r"""Differentiate functionals of the state at nodes with respect to the controls.

    For a functional :math:`g(x_k)` the discrete adjoint is :math:`\lambda_k = g_x` and
    :math:`\lambda_j = A_j^T \lambda_{j+1}`; its derivatives are
    :math:`g_{u_j} = B_j^T \lambda_{j+1}` and :math:`g_{h_j} = c_j^T \lambda_{j+1}`.

    Args:
        sensitivities: A, B and c of the intervals.
        nodes: Node of each functional, shape (m,).
        seeds: Its gradient with respect to the state there, shape (m, 2n).

    Returns:
        Derivatives with respect to torques, shape (m, N, n), and lengths, shape (m, N).
    """
    A, B, c = sensitivities
    count, _, n = B.shape
    by_control = np.zeros((nodes.size, count, n))
    by_length = np.zeros((nodes.size, count))
    order = np.argsort(-nodes, kind="stable")
    first = np.searchsorted(-nodes[order], -np.arange(count + 1), side="right")
    costate = seeds[order].copy()
    for j in range(count - 1, -1, -1):
        # Rows whose node lies behind interval j.
        live = slice(0, first[j + 1])
        rows = costate[live]
        by_control[live, j] = rows @ B[j]
        by_length[live, j] = rows @ c[j]
        costate[live] = rows @ A[j]
    back = np.empty_like(order)
    back[order] = np.arange(order.size)
    return by_control[back], by_length[back]
