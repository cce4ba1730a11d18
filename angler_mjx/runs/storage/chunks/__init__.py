"""A world of an array as bytes: shards of many worlds, and values in whole steps."""
