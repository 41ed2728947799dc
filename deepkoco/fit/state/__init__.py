"""The state of a system now, from measurements that are late."""
