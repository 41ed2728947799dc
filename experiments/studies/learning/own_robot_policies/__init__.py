"""Study: policies trained in the mended model of a robot of one's own, run on units that the package did not write."""
