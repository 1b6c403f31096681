"""What lies in shards: in a folder or at an address, in Parquet files that are whole or not there."""
