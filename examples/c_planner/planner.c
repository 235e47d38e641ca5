/* A planner in C that hits balls through `imolo backend --clock lockstep`; docs/wire.md explains every step.
 *
 *   planner MOTIONS [LCM_URL]     MOTIONS is written by write_motions.py from any table.
 *
 * It follows the marker that flies, and of all motions that can start now takes the one whose hand and the ball come
 * nearest to each other, as soon as that is near enough. Once started, a motion is kept.
 */
#include <lcm/lcm.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#include "imolo_msgs_actuator_command_t.h"
#include "imolo_msgs_heartbeat_t.h"
#include "imolo_msgs_mocap_frame_t.h"
#include "imolo_msgs_plan_t.h"
#include "imolo_msgs_step_answer_t.h"
#include "imolo_msgs_step_request_t.h"

enum { SEEN = 16 /* frames of the ball */, LEAD = 8300 /* [us] frame to onset */, GAP = 30000 /* [us] */ };
enum { PHASES = 64, CHANNELS = 1024 }; /* at most */
static const double FAR = 2.2, NEAR = 0.03;         /* [m] of the first look at the ball, of hand and ball */
static const double GRAVITY = 9.81, DRAG = 0.172;   /* [m/s2], [1/m] of the foam ball */

struct tuple { int motion; double t, at[3]; };      /* t [us] after its onset the hand of the motion is there */

static char robot[64];
static int motions, phases, channels, tuples;
static double *u; /* of each motion: ends of the phases [us], then the targets of each phase */
static struct tuple *reach, *chosen;
static lcm_t *lcm;
static int64_t me, backend, answered, onset, seen_utime[SEEN];
static int seen, sequence;
static double ball[SEEN][3];
static uint8_t memory[65536];
static int memory_size;

static void fail(const char *what, const char *which) {
    fprintf(stderr, "planner: %s %s\n", what, which);
    exit(2);
}

static double distance(const double *p, const double *q) {
    return sqrt(pow(p[0] - q[0], 2) + pow(p[1] - q[1], 2) + pow(p[2] - q[2], 2));
}

static void read_motions(const char *path) {
    FILE *file = fopen(path, "r");
    if (!file) fail("cannot open", path);
    int good = fscanf(file, "%63s %d %d %d %d", robot, &motions, &phases, &channels, &tuples) == 5 && motions > 0
        && phases > 0 && phases <= PHASES && channels > 0 && channels <= CHANNELS && tuples > 0;
    size_t numbers = good ? (size_t)motions * phases * (1 + channels) : 0;
    if (good) good = (u = calloc(numbers, sizeof *u)) && (reach = calloc(tuples, sizeof *reach));
    for (size_t i = 0; good && i < numbers; i++) good = fscanf(file, "%lf", u + i) == 1;
    for (struct tuple *r = reach; good && r < reach + tuples; r++)
        good = fscanf(file, "%d %lf %lf %lf %lf", &r->motion, &r->t, r->at, r->at + 1, r->at + 2) == 5
            && r->motion >= 0 && r->motion < motions;
    fclose(file);
    if (!good) fail("write it with write_motions.py; cannot read", path);
}

/* Keep the unlabelled marker that comes from afar, and then what moves on from there. */
static void see(const imolo_msgs_mocap_frame_t *frame) {
    const double *last = ball[(seen + SEEN - 1) % SEEN], *found = NULL;
    if (seen && frame->utime - seen_utime[(seen - 1) % SEEN] > GAP) seen = 0; /* it was a reflection */
    double best = seen ? 0.15 : INFINITY; /* [m] a ball flies from frame to frame, one being lost */
    for (const imolo_msgs_marker_t *m = frame->markers; m < frame->markers + frame->num_markers; m++) {
        if (m->marker_id != IMOLO_MSGS_MARKER_T_UNLABELLED || (!seen && m->marker_position[0] < FAR)) continue;
        double way = seen ? distance(m->marker_position, last) : 0.0;
        if (way < best) best = way, found = m->marker_position;
    }
    if (!found) return;
    if (seen == 1 && best < 0.02) seen = 0; /* not yet thrown */
    memcpy(ball[seen % SEEN], found, sizeof *ball);
    seen_utime[seen++ % SEEN] = frame->utime;
}

static double acceleration(const double *v, int axis) {
    return -DRAG * distance(v, (double[3]){0}) * v[axis] - (axis == 2 ? GRAVITY : 0.0);
}

/* Least squares: place p [m] and velocity v [m/s] at `now`; the second round knows how the air slows the ball. */
static void fit(int64_t now, double *p, double *v) {
    memset(v, 0, 3 * sizeof *v);
    for (int round = 0; round < 2; round++) {
        double a[3] = {acceleration(v, 0), acceleration(v, 1), acceleration(v, 2)};
        for (int axis = 0; axis < 3; axis++) {
            double st = 0, stt = 0, sp = 0, spt = 0;
            for (int i = 0; i < SEEN; i++) {
                double t = 1e-6 * (seen_utime[i] - now), fallen = ball[i][axis] - 0.5 * a[axis] * t * t;
                st += t, stt += t * t, sp += fallen, spt += fallen * t;
            }
            v[axis] = (SEEN * spt - st * sp) / (SEEN * stt - st * st), p[axis] = (sp - v[axis] * st) / SEEN;
        }
    }
}

/* Follow the ball, 1 ms a step, beside the tuples, which are in the order of their times. */
static void decide(int64_t now) {
    double p[3], v[3], best = NEAR;
    struct tuple *r = reach;
    fit(now, p, v);
    for (int64_t ahead = 1000; r < reach + tuples && p[2] > 0.0; ahead += 1000) {
        double a[3] = {acceleration(v, 0), acceleration(v, 1), acceleration(v, 2)};
        for (int axis = 0; axis < 3; axis++) v[axis] += 1e-3 * a[axis], p[axis] += 1e-3 * v[axis];
        for (; r < reach + tuples && LEAD + r->t < ahead + 500; r++) {
            double off = distance(r->at, p);
            if (off < best) best = off, chosen = r, onset = now + LEAD;
        }
    }
}

/* Say what is to be said to a frame: the command of the motion that runs, and the plan that the log is judged by. */
static int speak(const imolo_msgs_mocap_frame_t *frame, imolo_msgs_envelope_t *said) {
    static uint8_t command_bytes[32768], plan_bytes[1024];
    int64_t ends[PHASES];
    double *rows[PHASES];
    int count = 0;
    imolo_msgs_plan_t plan = {.utime = frame->utime, .answered_frame = frame->frame_number, .hit_probability = -1,
        .effector = -1, .state = seen ? IMOLO_MSGS_PLAN_T_TRACKING : IMOLO_MSGS_PLAN_T_WAITING};
    if (chosen) {
        double *motion = u + (size_t)chosen->motion * phases * (1 + channels);
        imolo_msgs_actuator_command_t command = {.utime = frame->utime, .command_sequence = ++sequence,
            .onset_utime = onset, .num_phases = phases, .num_targets = channels, .switch_utime = ends, .target = rows};
        for (int i = 0; i < phases; i++) ends[i] = onset + llround(motion[i]), rows[i] = motion + phases + i * channels;
        said[count].inner_channel = "ACTUATOR_COMMAND", said[count].inner_data = command_bytes;
        said[count++].inner_size =
            imolo_msgs_actuator_command_t_encode(command_bytes, 0, sizeof command_bytes, &command);
        plan.state = sequence == 1 ? IMOLO_MSGS_PLAN_T_STARTED : IMOLO_MSGS_PLAN_T_KEPT, plan.effector = 0;
        plan.plan_onset_utime = onset, plan.hit_utime = onset + llround(chosen->t);
        memcpy(plan.target_position, chosen->at, sizeof chosen->at);
    }
    said[count].inner_channel = "PLAN", said[count].inner_data = plan_bytes;
    said[count++].inner_size = imolo_msgs_plan_t_encode(plan_bytes, 0, sizeof plan_bytes, &plan);
    return count;
}

static void on_request(const lcm_recv_buf_t *b, const char *c, const imolo_msgs_step_request_t *asks, void *user) {
    (void)b, (void)c, (void)user;
    if (asks->asking_backend > backend) backend = asks->asking_backend, answered = 0;
    if (asks->asking_backend < backend || asks->step_number < answered) return; /* nobody waits for it any more */
    if (asks->step_number > answered) { /* else asked again: the same bytes once more */
        imolo_msgs_envelope_t said[2];
        imolo_msgs_mocap_frame_t frame;
        imolo_msgs_step_answer_t answer = {.answering_planner = me, .answered_backend = backend,
            .answered_step = asks->step_number, .answers = said,
            .state_lost = asks->previous_step != 0 && asks->previous_step != answered};
        if (asks->previous_step == 0) seen = sequence = 0, chosen = NULL; /* a trial starts */
        if (!answer.state_lost) answered = asks->step_number;
        if (!answer.state_lost && !strcmp(asks->asked.inner_channel, "MOCAP")
            && imolo_msgs_mocap_frame_t_decode(asks->asked.inner_data, 0, asks->asked.inner_size, &frame) >= 0) {
            see(&frame);
            if (!chosen && seen >= SEEN) decide(frame.utime);
            answer.num_answers = speak(&frame, said);
            imolo_msgs_mocap_frame_t_decode_cleanup(&frame);
        }
        memory_size = imolo_msgs_step_answer_t_encode(memory, 0, sizeof memory, &answer);
    }
    lcm_publish(lcm, "STEP_ANSWER", memory, memory_size);
}

int main(int argc, char **argv) {
    if (argc < 2) fail("usage:", "planner MOTIONS [LCM_URL]");
    read_motions(argv[1]);
    const char *url = argc > 2 ? argv[2] : "udpm://239.255.76.67:7667?ttl=0";
    if (!(lcm = lcm_create(url))) fail("cannot open the bus", url);
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    me = now.tv_sec * 1000000000LL + now.tv_nsec; /* a later start has the larger number */
    imolo_msgs_step_request_t_subscribe(lcm, "STEP_REQUEST", on_request, NULL);
    for (int64_t next = 0;; lcm_handle_timeout(lcm, 20)) { /* [ms] */
        clock_gettime(CLOCK_MONOTONIC, &now);
        int64_t utime = now.tv_sec * 1000000LL + now.tv_nsec / 1000;
        if (utime < next) continue;
        imolo_msgs_heartbeat_t beat = {.beat_utime = utime, .role = "planner", .instance = me, .pid = getpid(),
            .node_robot = robot, .clock_mode = "", .activity = "planning in C"};
        imolo_msgs_heartbeat_t_publish(lcm, "HEARTBEAT", &beat);
        next = utime + 100000; /* ten times a second: silent for one, it counts as lost */
    }
}
