"""Map the joints of a log to those of a model with named joints: names, units, signs and zeros, with the evidence."""

from deepkoco.logs.inspect.joints.proposer import has_named_joints, propose_joints

__all__ = ["has_named_joints", "propose_joints"]
