"""The run store: trains, predicts and scores whatever is missing, on this machine or a cluster, and keeps it."""
