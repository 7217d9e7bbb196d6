// The list of jobs.
