"""One plugin per published method, each reading what its official training code writes."""
