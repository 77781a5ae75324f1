"""Exact moments of the error, the limit of infinitely many seeds, for observers and plants that are affine in the noise.

For a given schedule, the joint state of plant, observers, controller and packets in flight is an affine function of independent
standard normals xi (initial state, measurement noise, process noise, command noise). So is the error:

    z_k = m_k + sum_j B_kj xi_j,      E z_k = m_k,      cov z_k = P_k = sum_j B_kj B_kj'

m is the run without noise. P is propagated by the matrix of a tick or an event, P+ = F P F' + G G'. F and G are derivatives of
the simulated functions (`noise_state`), recomputed only where they change (`programs`). A sample's noise is added when the
sample arrives (`events`). Times are ticks; values are those after the jump.

That a grid point is affine is tested, not assumed: a run with noise is propagated too, and must agree with the linear maps
(`exactness`).
"""
