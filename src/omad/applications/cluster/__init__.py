"""Work in shards, on all cores of a machine or of a cluster: each shard is a file that is whole or not there."""
