/* A planner in C that hits balls through `imolo backend --clock lockstep`; docs/wire.md explains every step.
 *
 *   planner MOTIONS [LCM_URL]     MOTIONS is written by write_motions.py from any table.
 *
 * It fits a parabola to the marker that flies, and of all motions that could still be started takes the one that brings the
 * hand nearest to the ball at the right time. Once started, a motion is kept.
 */
#include <lcm/lcm.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include "imolo_msgs_actuator_command_t.h"
#include "imolo_msgs_heartbeat_t.h"
#include "imolo_msgs_mocap_frame_t.h"
#include "imolo_msgs_plan_t.h"
#include "imolo_msgs_step_answer_t.h"
#include "imolo_msgs_step_request_t.h"
#include "imolo_msgs_trial_event_t.h"

enum { SEEN = 12, LEAST = 10, LEAD = 8300 /* [us] from a frame to an onset */, LATEST = 800000 /* [us] ahead */ };
static const double FAR = 2.2, NEAR = 0.035, GRAVITY = 9.81, DRAG = 0.172; /* [m], [m], [m/s2], [1/m] of the foam ball */

static char robot[64];
static int motions, phases, channels, tuples;
static double *U;                       /* of each motion: ends of the phases [us], then the targets, row by row */
static struct { int motion; double t, at[3]; } *reach;
static lcm_t *lcm;
static int64_t me, backend, answered = -1, onset, seen_utime[SEEN];
static int seen, chosen, sequence;
static double ball[SEEN][3];
static uint8_t memory[65536];
static int memory_size;

static void fail(const char *why) { fprintf(stderr, "planner: %s\n", why); exit(2); }

static void read_motions(const char *path) {
    FILE *file = fopen(path, "r");
    if (!file || fscanf(file, "%63s %d %d %d %d", robot, &motions, &phases, &channels, &tuples) != 5) fail("cannot read the motions");
    int width = phases * (1 + channels);
    U = malloc(sizeof *U * motions * width), reach = malloc(sizeof *reach * tuples);
    for (int i = 0; i < motions * width; i++) if (fscanf(file, "%lf", U + i) != 1) fail("the motions are cut off");
    for (int i = 0; i < tuples; i++)
        if (fscanf(file, "%d %lf %lf %lf %lf", &reach[i].motion, &reach[i].t, reach[i].at, reach[i].at + 1, reach[i].at + 2) != 5) fail("the tuples are cut off");
    fclose(file);
}

static void begin_trial(void) { seen = sequence = 0, chosen = -1, onset = 0; }

/* Keep the last samples of the unlabelled marker that is far away, and then of what goes on from there. */
static void see(const imolo_msgs_mocap_frame_t *frame) {
    double best = seen ? 0.15 : 1e9; /* [m] a ball flies no farther from frame to frame */
    const double *found = NULL;
    for (int i = 0; i < frame->num_markers; i++) {
        const imolo_msgs_marker_t *marker = frame->markers + i;
        const double *p = marker->marker_position, *last = seen ? ball[(seen - 1) % SEEN] : p;
        double way = sqrt(pow(p[0] - last[0], 2) + pow(p[1] - last[1], 2) + pow(p[2] - last[2], 2));
        if (marker->marker_id == IMOLO_MSGS_MARKER_T_UNLABELLED && (seen || p[0] > FAR) && way < best) best = way, found = p;
    }
    if (!found) return;
    if (seen == 1 && best < 0.02) seen = 0; /* not yet thrown */
    memcpy(ball[seen % SEEN], found, sizeof *ball), seen_utime[seen % SEEN] = frame->utime, seen++;
}

/* Least squares: velocity and place at `now` from the kept samples, gravity known. */
static void fit(int64_t now, double place[3], double velocity[3]) {
    for (int axis = 0; axis < 3; axis++) {
        double n = SEEN, st = 0, stt = 0, sp = 0, spt = 0;
        for (int i = 0; i < SEEN; i++) {
            double t = 1e-6 * (seen_utime[i] - now), p = ball[i][axis] + (axis == 2 ? 0.5 * GRAVITY * t * t : 0.0);
            st += t, stt += t * t, sp += p, spt += p * t;
        }
        velocity[axis] = (n * spt - st * sp) / (n * stt - st * st), place[axis] = (sp - velocity[axis] * st) / n;
    }
}

/* Follow the ball, slowed by the air, and look for the tuple that meets it. */
static void decide(int64_t now) {
    double p[3], v[3], best = NEAR;
    fit(now, p, v);
    for (int64_t ahead = 1000; ahead < LATEST && p[2] > 0.0; ahead += 1000) {
        double speed = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        for (int axis = 0; axis < 3; axis++)
            v[axis] -= 1e-3 * (DRAG * speed * v[axis] + (axis == 2 ? GRAVITY : 0.0)), p[axis] += 1e-3 * v[axis];
        for (int i = 0; i < tuples; i++) {
            if (fabs(reach[i].t - (ahead - LEAD)) > 500.0) continue;
            double off = sqrt(pow(reach[i].at[0] - p[0], 2) + pow(reach[i].at[1] - p[1], 2) + pow(reach[i].at[2] - p[2], 2));
            if (off < best) best = off, chosen = reach[i].motion, onset = now + LEAD;
        }
    }
}

/* What the planner says to a frame: the command of the motion that runs, and a plan, which the log is judged by. */
static int speak(const imolo_msgs_mocap_frame_t *frame, imolo_msgs_envelope_t *said) {
    static uint8_t bytes[2][32768];
    static int64_t ends[64];
    static double *rows[64], zero[1];
    imolo_msgs_plan_t plan = {.utime = frame->utime, .answered_frame = frame->frame_number, .hit_probability = -1, .effector = -1, .theta = zero};
    int count = 0;
    if (chosen >= 0) {
        imolo_msgs_actuator_command_t command = {.utime = frame->utime, .command_sequence = ++sequence, .onset_utime = onset,
            .num_phases = phases, .num_targets = channels, .switch_utime = ends, .target = rows};
        double *u = U + chosen * phases * (1 + channels);
        for (int i = 0; i < phases; i++) ends[i] = onset + (int64_t)u[i], rows[i] = u + phases + i * channels;
        said[count].inner_channel = "ACTUATOR_COMMAND", said[count].inner_data = bytes[0];
        said[count++].inner_size = imolo_msgs_actuator_command_t_encode(bytes[0], 0, sizeof bytes[0], &command);
        plan.state = IMOLO_MSGS_PLAN_T_STARTED, plan.plan_onset_utime = onset, plan.effector = 0;
    }
    said[count].inner_channel = "PLAN", said[count].inner_data = bytes[1];
    said[count++].inner_size = imolo_msgs_plan_t_encode(bytes[1], 0, sizeof bytes[1], &plan);
    return count;
}

static void on_request(const lcm_recv_buf_t *buffer, const char *channel, const imolo_msgs_step_request_t *request, void *user) {
    (void)buffer, (void)channel, (void)user;
    if (request->asking_backend != backend) backend = request->asking_backend, answered = -1;
    if (request->step_number < answered) return;
    if (request->step_number != answered) { /* else: asked again, and the same bytes are sent again */
        imolo_msgs_envelope_t said[2];
        imolo_msgs_step_answer_t answer = {.answering_planner = me, .answered_backend = backend, .answered_step = request->step_number, .answers = said};
        if (request->previous_step == 0) begin_trial();
        else answer.state_lost = request->previous_step != answered;
        imolo_msgs_mocap_frame_t frame;
        if (!strcmp(request->asked.inner_channel, "MOCAP") && imolo_msgs_mocap_frame_t_decode(request->asked.inner_data, 0, request->asked.inner_size, &frame) >= 0) {
            see(&frame);
            if (chosen < 0 && seen >= SEEN && seen >= LEAST) decide(frame.utime);
            answer.num_answers = speak(&frame, said);
            imolo_msgs_mocap_frame_t_decode_cleanup(&frame);
        }
        answered = request->step_number;
        memory_size = imolo_msgs_step_answer_t_encode(memory, 0, sizeof memory, &answer);
    }
    lcm_publish(lcm, "STEP_ANSWER", memory, memory_size);
}

int main(int argc, char **argv) {
    if (argc < 2) fail("usage: planner MOTIONS [LCM_URL]");
    read_motions(argv[1]);
    lcm = lcm_create(argc > 2 ? argv[2] : "udpm://239.255.76.67:7667?ttl=0");
    if (!lcm) fail("cannot open the bus");
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    me = now.tv_sec * 1000000000LL + now.tv_nsec; /* a later start has the larger number */
    begin_trial();
    imolo_msgs_step_request_t_subscribe(lcm, "STEP_REQUEST", on_request, NULL);
    for (;;) { /* a heartbeat ten times a second; nothing else tells the backend that there is a planner */
        clock_gettime(CLOCK_MONOTONIC, &now);
        static int64_t last;
        int64_t utime = now.tv_sec * 1000000LL + now.tv_nsec / 1000;
        if (utime - last >= 100000) {
            imolo_msgs_heartbeat_t beat = {.beat_utime = utime, .role = "planner", .instance = me, .node_robot = robot, .clock_mode = "", .activity = "planning in C"};
            imolo_msgs_heartbeat_t_publish(lcm, "HEARTBEAT", &beat), last = utime;
        }
        lcm_handle_timeout(lcm, 20);
    }
}
