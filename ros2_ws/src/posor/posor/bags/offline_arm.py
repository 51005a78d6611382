"""An arm for offline use: its joints and endpoint from a bag, in memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.bags.arm_estimator import ArmEstimator
from posor.bags.offline_pipeline import estimate_bag, topics_of
from posor.bags.reprocess_task import Settings
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.errors import checked_path
from posor.estimation.estimate import Estimates
from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates

if TYPE_CHECKING:
    from pathlib import Path

    from posor.node_parameters import CovarianceKind


class Arm(ArmFile):
    """An arm file with its paths resolved, which estimates recorded scans."""

    def estimate(
        self, bag: Path | str, *, covariance: CovarianceKind | None = None, false_alarm: float | None = None
    ) -> ArmEstimates:
        """Return the poses and covariances of all joints and of the endpoint, as the nodes would have published them.

        Args:
            bag: Folder with metadata.yaml, or a single .mcap or .db3 file, with scans on topics ``.../<joint>/raw``.
            covariance: Part of the uncertainty in the endpoint's covariances, and in ``Estimates.covariances()`` of
                the joints: from the readings' noise (random), from the calibration (systematic), or both (total).
                None: the part that the arm file states for each joint; total where the file states no part.
            false_alarm: Probability that the chi-square test rejects a correct scan; None: as the arm file states.

        Raises:
            ParameterError: There is no such part of the uncertainty, or ``false_alarm`` is not a probability.
            PosorError: The bag, a calibration or the kinematic chain cannot be used.

        """
        path = checked_path(bag, "Arm.estimate", "the path of a bag")
        settings = Settings.of_arm(self).with_estimation(covariance=covariance, false_alarm=false_alarm)
        estimator = ArmEstimator(settings)
        parts = list(estimate_bag(path, topics_of(path, settings.joints), estimator))
        joints = {name: Estimates.concatenate([part.joints[name] for part in parts]) for name in settings.joints}
        return ArmEstimates(joints, EndpointEstimates.concatenate([part.endpoint for part in parts]), parts[0].chain)

    def __repr__(self) -> str:
        return f"<Arm {self.name} of {self.path}: {', '.join(self.calibrations)}>"


def load_arm(path: Path | str) -> Arm:
    """Read an arm file; the files that it names are read by ``Arm.estimate``.

    Raises:
        ParameterError: The argument is no path.
        CalibrationError: The file cannot be read, is not YAML, or has invalid content.

    """
    return Arm(**vars(load_arm_file(checked_path(path, "load_arm", "the path of an arm file"))))
