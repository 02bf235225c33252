"""The numbers of `trust`, as `pose-eval trust` printed them."""

from pose_server.pairs.trust import TrustModel

# fitted on church_herzjesu-sparse_noisy, house_dtu24-sparse_noisy, portal_lund-sparse_noisy,
# ring_temple-sparse_noisy
MODEL = TrustModel(
    expected=(
        (-0.0262, -2.026, 0.5207, -0.7702, -0.3124, 0.8642),
        (0.2109, -1.635, 0.2487, -0.4728, -0.248, 1.351),
        (3.786, -3.349, 0.7587, 0.1052, 0.3147, 0.8651),
    ),
    scatter=(0.2801, 0.3556, 0.4342),
    weights=(
        0.3062,  # explained_lacking
        0.3144,  # unguided_lacking
        0.3584,  # agreement_lacking
        0.3578,  # explained_poor
        0,  # unguided_poor
        0,  # agreement_poor
        0.4391,  # few_exact
        0.01318,  # few_unguided
        0.2357,  # hazy
        1.644,  # loose_depths
        0.567,  # seen_through
        5.186,  # from_behind
        1.517,  # undetermined
        1.885,  # rival
    ),
    bias=3.151,
)
