"""Which object is this, whatever its pose: retrieval by shape parameters, and the Siamese baseline.

search       nearest vectors, exactly
approximate  the same, nearly, from FAISS (an extra)
signature    what an estimate or an object model is known by: beta, its covariance, and whose prior speaks
index        the catalogue: entries, search, one file
picture      thumbnails, and a ranking as a picture
catalogue    entries from object models, views and observations
siamese      the baseline: a PointNet++ with contrastive loss
metrics      mAP@10, nearest neighbour, first and second tier
distances    how alike views are, by every way that is compared
shards       what takes long, kept on disk as it comes
pool         what estimators say of many views of many objects
experiment   galleries drawn from a pool: the paper's Table 3
"""
