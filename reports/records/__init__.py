"""What is stored of a campaign: the schemas of its records, versioned, and how a folder of them is read. Validate imports this and little else of reports."""
