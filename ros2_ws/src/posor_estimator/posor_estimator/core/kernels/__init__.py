"""Scalar kernels: one home for each formula of the measurement model, written so that they can be compiled.

Conventions in every kernel:

* ``T_R_T`` is given as ``rotation`` (3x3) and ``translation`` (3): ``p_R = rotation @ p_T + translation`` [m].
* A row is one scalar reading. Its geometry is one flat array of parameters; the layout stands beside each kernel.
* Pose derivatives are with respect to the local tangent of pinocchio: ``T_R_T * exp6((v, w))``, v [m] and w [rad] in
  the axes of T, translation first.
"""
