"""What the page on the virtual TacTip measures of the methods, beside the published experiment itself."""
