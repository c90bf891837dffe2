"""View stores and the pairs drawn from them, whether rendered, cut from photographs or from videos."""
