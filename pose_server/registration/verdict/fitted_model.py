"""The numbers of `grave_probability`, as `pose-eval trust` printed them."""

from fleetpose.pose_server.registration.verdict.grave_probability import TrustModel

# fitted on church_herzjesu (sparse_noisy, also half mirrored), ring_temple and house_dtu24
# (sparse_noisy), rgbd_7scenes_redkitchen_A, courtyard2 u40 s21 (sparse_noisy), courtyard4 u30 s27
# and facade u40 s23 (stereo_pair_sparse), weak u15 s22 (stereo_dense)
MODEL = TrustModel(
    expected=(
        (-0.5068, -1.219, 0.2495, -0.4334, -0.1004, 0.2394),
        (-0.142, -1.114, 0.2076, -0.09762, -0.0575, 0.2935),
        (3.529, -2.453, 0.3538, -0.55, 0.1111, 0.7565),
        (5.094, -1.871, 0.7228, -0.3965, 0.152, 0.8501),
    ),
    scatter=(0.3621, 0.409, 0.532, 0.6626),
    weights=(
        0.1875,  # unexplained
        0.1875,  # found_by_guidance_alone
        0.1875,  # surfaces_disagree
        0.5323,  # seen_through
        0.2506,  # few_exact
        0.2002,  # few_unguided
        0.1468,  # hazy
        0.767,  # loose_depths
        8.33,  # from_behind
        0.2041,  # undetermined
        1.142,  # rival
        41.3,  # holes
    ),
    bias=-5.168,
)
