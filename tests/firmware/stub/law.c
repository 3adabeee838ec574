/* The stub has no law. */
typedef int no_law;
