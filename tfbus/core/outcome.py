"""Numbers that the parts of the kernel share: how something ended, and what can be.

Plain numbers, so that each compiled module can hold them as C numbers of its own.
"""

# What became of a sample.
KEPT = 0
TOO_OLD = 1
REPEATED = 2
CONFLICT = 3

# Answers to a question for the latest stamp; no sample has such stamps.
NO_DATA = -(2**63)
ALL_STATIC = 2**63 - 1

# As far as stamps may be from 1970, and so as long as a cache can be: differences fit 64 bits.
LONGEST_NS = 2**62

# tf2's tolerance (its "TF_DENORMALIZED_QUATERNION"): the squared norm is within 0.01 of one.
QUATERNION_TOLERANCE = 0.01
# So near is the squared norm of a quaternion that was normalised before.
UNIT_TO_THE_LAST_BIT = 4.5e-16
