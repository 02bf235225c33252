"""The numbers of `trust`, as `pose-eval trust` printed them."""

from pose_server.pairs.trust import TrustModel

# fitted on church_herzjesu-sparse_noisy, church_mirror, courtyard2-u40-s21-sparse_noisy,
# facade-u40-s23-stereo_pair_sparse, house_dtu24-sparse_noisy, rgbd_7scenes_redkitchen_A--,
# ring_temple-sparse_noisy, weak-u15-s22-stereo_dense
MODEL = TrustModel(
    expected=(
        (-0.4135, -1.595, 0.4441, -0.8046, -0.1023, 0.3997),
        (0.008148, -1.622, 0.4241, -0.4711, -0.09429, 0.4353),
        (3.637, -2.924, 0.5978, -0.2327, 0.2653, 0.7876),
        (5.177, -2.307, 0.9719, -0.3371, 0.2179, 0.9306),
        (3.301, -1.792, 0.6409, -0.7997, 0.03845, 0.4419),
    ),
    scatter=(0.4271, 0.4097, 0.5091, 0.6307, 0.6719),
    weights=(
        0.07795,  # unexplained
        0.1609,  # found_by_guidance_alone
        0,  # surfaces_disagree
        0.4419,  # seen_through
        0.1886,  # holes
        0,  # few_exact
        0,  # few_unguided
        0.0919,  # hazy
        0.5532,  # loose_depths
        6.742,  # from_behind
        0.5113,  # undetermined
        0.8626,  # rival
    ),
    bias=-3.477,
)
