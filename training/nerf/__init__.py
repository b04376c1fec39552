"""The paper's deferred NeRF: positional encoding, a deep MLP, coarse and fine hierarchical sampling."""
