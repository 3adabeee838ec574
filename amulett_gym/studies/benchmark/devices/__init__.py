"""The benchmark over the devices of fleets: trained and tuned on some, judged on others."""
