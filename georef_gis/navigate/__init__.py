"""Where the camera was and how it was turned: filters, smoothers, clocks, comparisons."""
