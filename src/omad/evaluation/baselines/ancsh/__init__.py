"""A-NCSH, the baseline (Li et al., "Category-Level Articulated Object Pose Estimation", 2020).

A network says of every point which part it is of and where it is in two normalised spaces, that of its part (NPCS)
and that of the whole object at rest (NAOCS), and points to the joints. Parts are then aligned with the cloud, one by
one and together.

    coordinates  what the network is to say of a view
    net          the network
    similarity   RANSAC and similarity alignment of each part
    chain        the parts again, held together by their joints
    alignment    all of that, and votes for joints: from the network's answer to part poses and joints
    training     as OMADNet is trained, with its own losses
    estimator    from an observation to its pose
"""
