"""The numbers of `trust`, as `pose-eval trust` printed them."""

from pose_server.pairs.trust import TrustModel

# fitted on church_herzjesu (sparse_noisy, also half mirrored), ring_temple and house_dtu24
# (sparse_noisy), rgbd_7scenes_redkitchen_A, courtyard2 u40 s21 (sparse_noisy), courtyard4 u30 s27
# and facade u40 s23 (stereo_pair_sparse), weak u15 s22 (stereo_dense)
MODEL = TrustModel(
    expected=(
        (-0.4553, -1.559, 0.4574, -0.5835, -0.05787, 0.3516),
        (-0.06566, -1.309, 0.2496, -0.248, -0.07289, 0.3634),
        (3.598, -2.678, 0.471, -0.5725, 0.1835, 0.7844),
        (5.173, -2.005, 0.7534, -0.4356, 0.1912, 0.8705),
    ),
    scatter=(0.4194, 0.4044, 0.5275, 0.6369),
    weights=(
        0.1875,  # unexplained
        0.1896,  # found_by_guidance_alone
        0.1875,  # surfaces_disagree
        0.4367,  # seen_through
        0.2525,  # few_exact
        0.202,  # few_unguided
        0.1434,  # hazy
        1.126,  # loose_depths
        8.1,  # from_behind
        0.2083,  # undetermined
        1.902,  # rival
        33.12,  # holes
    ),
    bias=-4.891,
)
