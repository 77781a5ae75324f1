"""Exact moments of the error: what infinitely many seeds would say, where observer and plant are affine in the noise.

Given its schedule, the joint state of plant, observers, controller and packets on their way is an affine function of
independent unit normals xi (start, measurement noise, process noise, noise of commands), and so is the error:

    z_k = m_k + sum_j B_kj xi_j,      E e_k = m_k,      cov e_k = sum_j B_kj B_kj'

m is the run without noise; a *direction* B_j is the derivative of the run along xi_j, carried through the very functions that
are simulated (`jax.jvp`). A sample brings new directions; when there is no room for more they are compressed: an orthogonal
change of xi leaves all covariances as they are, and as many directions as the joint state has numbers always suffice
(square-root form: Kaminski, Bryson, Schmidt, IEEE TAC 16 (1971), 727). Times are ticks, values those after the jump.

That a cell is affine is not taken on trust: runs with noise are carried beside, and must stay where directions say (`affine`).
"""
