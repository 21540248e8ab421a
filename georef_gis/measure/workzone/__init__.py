"""Work zones: screening of measured devices against a manual's figures, and the WZDx feed."""
