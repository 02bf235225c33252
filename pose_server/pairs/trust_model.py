"""The numbers of `trust`, as `pose-eval trust` printed them."""

from pose_server.pairs.trust import TrustModel

# fitted on church_herzjesu-sparse_noisy, courtyard2-u40-s21-sparse_noisy, house_dtu24-sparse_noisy,
# ring_temple-sparse_noisy
MODEL = TrustModel(
    expected=(
        (-0.0893, -2.076, 0.6825, -1.325, -0.2256, 0.7049),
        (0.1396, -1.721, 0.431, -1.182, -0.1608, 1.124),
        (3.814, -3.35, 0.8608, -0.7335, 0.3621, 0.8864),
        (5.125, -2.056, 0.8835, -1.813, 0.3655, 1.472),
        (3.496, -2.235, 0.8315, -0.5659, 0.08148, 0.6632),
    ),
    scatter=(0.3188, 0.4154, 0.4372, 0.5779, 0.5291),
    weights=(
        0.02395,  # unexplained
        0.07637,  # found_by_guidance_alone
        0.1657,  # surfaces_disagree
        0.3813,  # seen_through
        0.2407,  # holes
        0.1112,  # few_exact
        0,  # few_unguided
        0.3935,  # hazy
        2.324,  # loose_depths
        4.327,  # from_behind
        0.8334,  # undetermined
        1.324,  # rival
    ),
    bias=-1.186,
)
