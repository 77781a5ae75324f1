"""Exact moments of the error: what infinitely many seeds would say, where observer and plant are affine in the noise.

Given its schedule, the joint state of plant, observers, controller and packets on their way is an affine function of
independent unit normals xi (start, measurement noise, process noise, noise of commands), and so is the error:

    z_k = m_k + sum_j B_kj xi_j,      E z_k = m_k,      cov z_k = P_k = sum_j B_kj B_kj'

m is the run without noise. P moves by the matrix of a tick or of an event, P+ = F P F' + G G', the derivative of the very
functions that are simulated (`noise_state`), taken anew only where it changes (`programs`). Noise of a sample joins when it
arrives (`events`). Times are ticks, values those after the jump.

That a cell is affine is not taken on trust: a run with noise is carried beside, and must stay where the maps put it
(`exactness`).
"""
