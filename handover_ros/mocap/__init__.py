"""Motion capture: recordings and live sources become clean, labelled, stamped marker frames."""
