/* The loops of loops.h, each in a text of its own (live_loop.c), for live.c, which chooses one at run time. */

#ifndef LIVE_H
#define LIVE_H

/* Of loop k: begin at rest, after the first reading; run a control tick that is not missed; end any control tick. `angle`
   [rad] and `slider` [m] are readings that the device has averaged before. */
#define DECLARE_LOOP(k)                                                                                            \
    void loop_begin_##k(const parameters *p, const loop_parameters *l, states *s, double *memory, double angle,    \
                        const double slider[2]);                                                                   \
    void loop_run_##k(const parameters *p, const loop_parameters *l, states *s, double *memory, double command[2]); \
    void loop_end_##k(const parameters *p, const loop_parameters *l, states *s, double *memory);

#endif
